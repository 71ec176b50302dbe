"""
A network of two machines on this one, which loses, delays, duplicates and reorders packets.

Each machine is a network namespace with one interface. As a program, this file relays the packets
between the two; nothing else is connected to them, so that no packet leaves this machine. Root is
needed: that of a container, or of `unshare -rn`.

"""

import contextlib
import ctypes
import fcntl
import heapq
import json
import os
import random
import selectors
import socket
import struct
import subprocess
import sys
import time

MACHINES = 'driver', 'node'
_NEW_NETWORK = 0x40000000  # CLONE_NEWNET
_SET_INTERFACE = 0x400454CA  # TUNSETIFF
_TUN, _NO_HEADER = 0x0001, 0x1000
_SET_ADDRESS, _SET_MASK, _GET_FLAGS, _SET_FLAGS = 0x8916, 0x891C, 0x8913, 0x8914
_UP = 0x0001
_PRIORITY = 60  # above that of the node
_NAME = struct.Struct('16s')
_SIZE = 1 << 16  # [bytes]; of a packet
_LIBC = ctypes.CDLL(None, use_errno=True)
NONE = {'loss': 0.0, 'delay': 0.0, 'jitter': 0.0, 'duplicates': 0.0, 'cut': []}
"""Faults: fractions of packets, times [s], and the machines from which nothing arrives."""


class Network:
    """
    The two machines, until `close` is called.

    Attributes
    ----------
    machines : dict of str to str
        For each machine the path of its network, for `enter`.

    """

    def __init__(self):
        self._relay = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        answer = self._relay.stdout.readline()
        if not answer.startswith('{'):
            self.close()
            raise PermissionError(f'there is no network to relay: {answer.strip()}')
        numbers = json.loads(answer)
        folder = f'/proc/{self._relay.pid}/fd'
        self.machines = {name: f'{folder}/{number}' for name, number in numbers.items()}

    def close(self):
        """Take the machines away."""
        self._relay.stdin.close()
        self._relay.stdout.close()
        self._relay.wait()

    def set(self, **faults):
        """Let packets suffer these faults, and no other ones, from now on; see `NONE`."""
        self._relay.stdin.write(json.dumps({**NONE, **faults}) + '\n')
        self._relay.stdin.flush()

    @contextlib.contextmanager
    def on(self, machine):
        """
        Open sockets on a machine, also in threads that are created within this context.

        Fast DDS looks for the interfaces once, so that a process can only be on one machine.
        """
        before = os.open('/proc/thread-self/ns/net', os.O_RDONLY)
        enter(self.machines[machine])
        try:
            yield
        finally:
            _call(_LIBC.setns, before, _NEW_NETWORK)
            os.close(before)


def enter(path):
    """Let this thread open its sockets in a network from now on."""
    network = os.open(path, os.O_RDONLY)
    _call(_LIBC.setns, network, _NEW_NETWORK)
    os.close(network)


def _call(function, *arguments):
    if function(*arguments):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _create_machine(address):
    """Move to a new network with one interface; return the network, and the end of the wire."""
    _call(_LIBC.unshare, _NEW_NETWORK)
    wire = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(wire, _SET_INTERFACE, struct.pack('16sH22x', b'wire', _TUN | _NO_HEADER))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for request, value in ((_SET_ADDRESS, address), (_SET_MASK, '255.255.255.0')):
            argument = struct.pack(
                '16sHH4s8x', b'wire', socket.AF_INET, 0, socket.inet_aton(value)
            )
            fcntl.ioctl(control, request, argument)
        for name in (b'wire', b'lo'):
            flags = fcntl.ioctl(control, _GET_FLAGS, struct.pack('16sH14x', name, 0))
            (given,) = struct.unpack_from('H', flags, _NAME.size)
            fcntl.ioctl(control, _SET_FLAGS, struct.pack('16sH14x', name, given | _UP))
    return os.open('/proc/self/ns/net', os.O_RDONLY), wire


def relay(wires, commands, chance):
    """
    Relay packets until there are no more commands.

    Parameters
    ----------
    wires : dict of str to int
        The open ends of the wires, by machine.
    commands : int
        An open file with a line of JSON for each change of the faults.
    chance : random.Random
        Which packets are lost, duplicated and late.

    """
    faults, waiting, count = NONE, [], 0
    other = dict(zip(MACHINES, MACHINES[::-1], strict=True))
    with selectors.DefaultSelector() as selector:
        selector.register(commands, selectors.EVENT_READ)
        for machine, wire in wires.items():
            selector.register(wire, selectors.EVENT_READ, machine)
        while True:
            patience = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
            for key, _ in selector.select(patience):
                if key.fd == commands:
                    lines = os.read(commands, _SIZE).splitlines()
                    if not lines:
                        return
                    faults = json.loads(lines[-1])
                    continue
                packet = os.read(key.fd, _SIZE)
                if key.data in faults['cut'] or chance.random() < faults['loss']:
                    continue
                for _ in range(1 + (chance.random() < faults['duplicates'])):
                    late = faults['delay'] + faults['jitter'] * chance.random()
                    count += 1  # packets that are due at the same time keep their order
                    entry = time.monotonic() + late, count, wires[other[key.data]], packet
                    heapq.heappush(waiting, entry)
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, wire, packet = heapq.heappop(waiting)
                os.write(wire, packet)


def run_first():
    """Let this thread, and those that it creates, run before others, if that is permitted."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))


def main():
    run_first()  # a busy machine must not add to the faults
    networks, wires = {}, {}
    try:
        for number, machine in enumerate(MACHINES, start=1):
            networks[machine], wires[machine] = _create_machine(f'10.23.0.{number}')
    except OSError as error:
        print(error, flush=True)
        return 1
    print(json.dumps(networks), flush=True)
    relay(wires, sys.stdin.fileno(), random.Random(1))
    return 0


if __name__ == '__main__':
    sys.exit(main())
