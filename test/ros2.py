"""
The parts of the `ros2` command line that the documents use; ros2cli itself is not on PyPI.

Messages are sent by rclpy to the real node. Usage: python test/ros2.py topic pub --once ...

Each command starts a process and discovers the others, which takes seconds. `main` with a `node`
saves them.

"""

import importlib
from pathlib import Path
import runpy
import signal
import sys
import time

from launch_arguments import ros_arguments
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
import yaml

PATIENCE = 60.0  # [s]


def main(arguments, node=None):
    ask = ask_alone if node is None else lambda question: question(node)
    match arguments:
        case ['run', 'inverse_dynamics_node', 'inverse_dynamics_node', *rest]:
            start(rest)
        case ['launch', 'inverse_dynamics_node', 'inverse_dynamics.launch.xml', *rest]:
            given = dict(x.split(':=', 1) for x in rest)
            start(['--ros-args', *ros_arguments(Path.cwd(), **given)])
        case ['topic', 'echo', '--once', topic]:
            print(ask(lambda node: echo(node, topic)))
        case ['topic', 'pub', '--once', topic, kind, text]:
            ask(lambda node: publish(node, topic, kind, text, None))
        case ['topic', 'pub', '-r', rate, topic, kind, text]:
            ask(lambda node: publish(node, topic, kind, text, float(rate)))
        case ['service', 'call', name, kind, text]:
            request = filled(class_of(kind).Request(), yaml.safe_load(text))
            print(ask(lambda node: call(node, class_of(kind), name, request)))
        case ['param', 'set', name, parameter, text]:
            value = Parameter(parameter, value=yaml.safe_load(text)).to_parameter_msg()
            request = SetParameters.Request(parameters=[value])
            kind, service = SetParameters, f'{name}/set_parameters'
            (result,) = ask(lambda node: call(node, kind, service, request)).results
            print('Set parameter successful' if result.successful else result.reason)
            return 0 if result.successful else 1
        case _:
            print(f'unknown command: ros2 {" ".join(arguments)}', file=sys.stderr)
            return 2
    return 0


def start(arguments):
    """Become the node."""
    sys.argv[1:] = arguments
    runpy.run_module('inverse_dynamics_node.node.main', run_name='__main__', alter_sys=True)


def ask_alone(question):
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('ros2_command')
    try:
        return question(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def wait_until(node, is_true, what):
    deadline = time.monotonic() + PATIENCE
    while not is_true():
        assert time.monotonic() < deadline, f'{what}: not within {PATIENCE:g} s'
        rclpy.spin_once(node, timeout_sec=0.05)


def echo(node, topic):
    def types():
        return dict(node.get_topic_names_and_types()).get(topic)

    wait_until(node, types, f'publisher of {topic}')
    received = []
    subscription = node.create_subscription(class_of(types()[0]), topic, received.append, 10)
    wait_until(node, lambda: received, f'message on {topic}')
    node.destroy_subscription(subscription)
    return received[0]


def publish(node, topic, kind, text, rate):
    message = filled(class_of(kind)(), yaml.safe_load(text))
    publisher = node.create_publisher(type(message), topic, 10)
    wait_until(node, publisher.get_subscription_count, f'subscription to {topic}')
    publisher.publish(message)
    if rate:
        stopped = []
        signal.signal(signal.SIGINT, lambda number, _: stopped.append(number))
        node.create_timer(1.0 / rate, lambda: publisher.publish(message))
        while not stopped:
            rclpy.spin_once(node, timeout_sec=0.1)
    else:
        publisher.wait_for_all_acked()
    node.destroy_publisher(publisher)


def call(node, kind, name, request):
    client = node.create_client(kind, name)
    wait_until(node, client.service_is_ready, f'service {name}')
    future = client.call_async(request)
    wait_until(node, future.done, f'answer of {name}')
    node.destroy_client(client)
    return future.result()


def class_of(kind):
    package, folder, name = kind.split('/')
    return getattr(importlib.import_module(f'{package}.{folder}'), name)


def filled(message, values):
    """Set the fields of a message from a mapping; unknown fields are errors."""
    for name, value in values.items():
        kind = message.get_fields_and_field_types()[name]
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        elif value and isinstance(value, list) and isinstance(value[0], dict):
            parent = class_of(
                kind.removeprefix('sequence<').removesuffix('>').replace('/', '/msg/')
            )
            setattr(message, name, [filled(parent(), each) for each in value])
        else:
            setattr(message, name, value)
    return message


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
