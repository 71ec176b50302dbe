"""Loads robot descriptions in the background."""

from __future__ import annotations

from concurrent.futures import Future

from ..control.loop import ControlLoop
from ..robot.model import RobotModel
from .background import Background
from .configure import build_loop, load_robot
from .parameters import Configuration


class DescriptionLoader:
    """
    Makes the control loop for a new robot description, which is read in the background.

    Reading takes tenths of a second, in which the robot must not be left without commands.

    Parameters
    ----------
    background : Background
        Reads the descriptions.

    """

    def __init__(self, background: Background) -> None:
        self._background = background
        self._loading: Future[tuple[RobotModel, str]] | None = None

    @property
    def is_loading(self) -> bool:
        """Whether a description is being loaded, or its loop has not been taken yet."""
        return self._loading is not None

    @property
    def is_ready(self) -> bool:
        """Whether a loop, or the reason why there is none, can be taken."""
        return self._loading is not None and self._loading.done()

    def load(self, configuration: Configuration, description: str) -> None:
        """
        Start to load a description; it replaces one that is still being loaded.

        Parameters
        ----------
        configuration : Configuration
            The parameters.
        description : str
            The URDF as XML text.

        """
        self.drop()
        self._loading = self._background.submit(load_robot, configuration, description)

    def drop(self) -> None:
        """Ignore the description that is being read."""
        if self._loading is not None:
            self._loading.cancel()
            self._loading = None

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
