"""Numbers written into the text of a URDF."""

import difflib

from inverse_dynamics_node import load_urdf
from inverse_dynamics_node.robot.rigid_body import RigidBody
from inverse_dynamics_node.robot.urdf.writer import Friction, rewrite
import numpy as np

URDF = """<?xml version="1.0"?>
<robot name="arm"><!-- a > b -->
  <link name="base"/>
  <link name="upper">
    <inertial>
      <!-- measured -->
      <origin rpy='0.3 -0.2 0.9' xyz='0 0 0.1'/>
      <mass value = "2.0"/>
      <inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <link name="lower"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="2"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="2"/>
    <dynamics friction="0.5" />
  </joint>
</robot>
"""
INERTIA = np.array([[0.3, 0.01, 0.02], [0.01, 0.25, -0.03], [0.02, -0.03, 0.2]])
BODY = RigidBody(1.0 / 3.0, np.array([0.1, -0.2, 1.0 / 7.0]), INERTIA)


def test_new_values_are_read_back_exactly_and_nothing_else_changes():
    friction = {'shoulder': Friction(0.1, 0.2), 'elbow': Friction(1.0 / 3.0, 0.0)}
    text = rewrite(URDF, {'upper': BODY, 'lower': BODY}, friction).decode()
    robot = load_urdf(text)
    for link in ('upper', 'lower'):
        k = robot.link_index(link)
        assert robot.link_mass[k] == BODY.mass
        np.testing.assert_array_equal(robot.link_com[k], BODY.com)
        np.testing.assert_allclose(robot.link_inertia[k], INERTIA, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(robot.damping, [0.1, 1.0 / 3.0])
    np.testing.assert_array_equal(robot.friction, [0.2, 0.0])
    before = rewrite(URDF, {}, {}).decode()  # differs from the file in quotes and spaces only
    changed = [line[2:].strip() for line in difflib.ndiff(before.split('\n'), text.split('\n'))
               if line.startswith('- ')]  # fmt: skip
    assert [line.split()[0] for line in changed] == [
        '<origin', '<mass', '<inertia', '<link', '<dynamics'
    ]  # fmt: skip
    assert '  <link name="lower">\n    <inertial>\n      <origin xyz=' in text
    assert '/>\n    </inertial>\n  </link>\n  <joint' in text
    assert '\n    <dynamics damping="0.1' in text


def test_encoding_comments_and_elements_are_kept(tmp_path):
    path = tmp_path / 'latin.urdf'
    latin = URDF.replace('?>', ' encoding="iso-8859-1"?>\n<!-- by Jürgen -->', 1)
    path.write_bytes(latin.replace('measured', 'gemäß').encode('latin-1'))
    text = rewrite(path, {}, {}).decode('latin-1')
    assert text.startswith('<?xml version="1.0" encoding="iso-8859-1"?>\n<!-- by Jürgen -->\n<ro')
    assert '<!-- a > b -->' in text
    assert '<!-- gemäß -->' in text
    assert load_urdf(text).link_mass.tolist() == load_urdf(path).link_mass.tolist()
