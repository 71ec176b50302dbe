"""Loads robot descriptions while the control loop runs."""

from __future__ import annotations

from concurrent.futures import Future

from ..control.loop import ControlLoop
from ..robot.model import RobotModel
from .configure import build_loop, load_robot
from .parameters import Configuration
from .worker import Worker


class DescriptionLoader:
    """
    Makes the control loop for a new robot description, which another process reads.

    Reading takes tenths of a second, in which the robot must not be left without commands.

    Parameters
    ----------
    worker : Worker
        Reads the descriptions.

    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        self._loading: Future[tuple[RobotModel, str]] | None = None
        self._next: tuple[Configuration, str] | None = None

    @property
    def is_loading(self) -> bool:
        """Whether a description is being loaded, or its loop has not been taken yet."""
        return self._loading is not None

    def poll(self) -> bool:
        """Start to read the description that waits; return whether a loop can be taken."""
        is_ready = self._loading is not None and self._loading.done()
        if self._next is not None and (is_ready or self._loading is None):
            self._loading = self._worker.submit(load_robot, *self._next)
            self._next = None
            return False
        return is_ready

    def load(self, configuration: Configuration, description: str) -> None:
        """
        Load a description as soon as the one that is being read is done; it replaces both others.

        Parameters
        ----------
        configuration : Configuration
            The parameters.
        description : str
            The URDF as XML text.

        """
        self._next = configuration, description
        self.poll()

    def drop(self) -> None:
        """Ignore the description that is being read, and the one that waits."""
        self._loading = self._next = None

    def take_loop(
        self, old: ControlLoop, configuration: Configuration, is_active: bool
    ) -> tuple[ControlLoop, list[str]]:
        """
        Return the new loop, with the state of the old one.

        Parameters
        ----------
        old : ControlLoop
            The loop in use.
        configuration : Configuration
            The parameters, which may have changed since `load`.
        is_active : bool
            Whether the old loop commands the robot: the new one then continues from its last
            command, otherwise only inputs such as payloads are copied.

        Returns
        -------
        loop : ControlLoop
            The loop for the new description.
        dropped : list of str
            Links with a payload that no longer exist.

        Raises
        ------
        InverseDynamicsError
            If the description cannot be used, or not instead of the old one.

        """
        assert self._loading is not None
        loading, self._loading = self._loading, None
        loop = build_loop(configuration, *loading.result())
        dropped = loop.continue_from(old) if is_active else loop.copy_inputs_from(old)
        return loop, dropped
