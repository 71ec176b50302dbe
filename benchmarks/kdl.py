"""
A worker (see `workers`) that runs KDL.

The worker imports only PyKDL. Debian's PyKDL works only with Debian's Python, and this package is
not installed there.
"""

import json
import sys
from time import thread_time

import PyKDL


def main():
    """Answer the requests on standard input."""
    task = json.loads(sys.stdin.readline())
    chain = PyKDL.Chain()
    for k, body in enumerate(task['bodies']):
        chain.addSegment(segment(f'{k}', body))
    n = len(task['bodies'])
    solver = PyKDL.ChainIdSolver_RNE(chain, PyKDL.Vector(*task['gravity']))
    forces = [PyKDL.Wrench() for _ in range(n)]
    efforts = PyKDL.JntArray(n)
    states = [tuple(vector(x) for x in state) for state in zip(*task['states'])]  # noqa: B905

    results = []
    for q, qd, qdd in states:
        solver.CartToJnt(q, qd, qdd, forces, efforts)
        results.append([efforts[k] for k in range(n)])
    print(json.dumps(results), flush=True)
    for line in sys.stdin:
        repeated = states * json.loads(line)
        start = thread_time()
        for q, qd, qdd in repeated:
            solver.CartToJnt(q, qd, qdd, forces, efforts)
        print((thread_time() - start) / len(repeated), flush=True)


def segment(name, body):
    """Create a segment; its tip frame is the URDF's frame of the joint."""
    origin, axis = PyKDL.Vector(*body['position']), PyKDL.Vector(*body['axis'])
    kind = PyKDL.Joint.TransAxis if body['slides'] else PyKDL.Joint.RotAxis
    tip = PyKDL.Frame(PyKDL.Rotation(*body['rotation']), origin)
    com = PyKDL.Vector(*body['com'])
    xx, xy, xz, yy, yz, zz = body['inertia']
    # KDL expects the inertia about the centre of mass, along the axes of the tip frame.
    inertia = PyKDL.RotationalInertia(xx, yy, zz, xy, xz, yz)
    return PyKDL.Segment(
        name,
        PyKDL.Joint(name, origin, axis, kind),
        tip,
        PyKDL.RigidBodyInertia(body['mass'], com, inertia),
    )


def vector(numbers):
    """Create a KDL joint array from numbers."""
    array = PyKDL.JntArray(len(numbers))
    for k, x in enumerate(numbers):
        array[k] = x
    return array


if __name__ == '__main__':
    main()
