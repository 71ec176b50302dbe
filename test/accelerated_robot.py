"""A robot in MuJoCo whose accelerations can be measured."""

from inverse_dynamics_node.simulation.mujoco.hardware import MujocoRobot
import mujoco


class AcceleratedRobot(MujocoRobot):
    """A simulated robot with accelerometers at its joints."""

    def accelerations(self):
        """Return the accelerations of ``robot.joint_names`` as if the brakes were open."""
        mujoco.mj_forward(self._model, self._data)
        self.world.act()
        mujoco.mj_forward(self._model, self._data)
        return self._data.qacc[self._order]
