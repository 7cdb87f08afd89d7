"""The twin: an arm behind a controller behind three ports, paced against the clock."""

from __future__ import annotations

import sys
from collections.abc import Mapping

from labhil.driver import ReadyCallback, TwinOptions
from labhil.errors import UnknownNameError, UsageError

DEFAULT_HOST = "127.0.0.1"


class Ur5Twin:
    """A UR5 that is not there; satisfies :class:`labhil.driver.Twin`.

    It runs in real time only. Its address is one of this machine; the ports are the controller's own
    (30004, 30003, 29999), so that several twins need several addresses.
    """

    name = "ur5"
    rig = "ur5"
    description = "simulated UR5 with its controller: RTDE, script upload and dashboard, 125 or 500 Hz"

    def terms(self) -> Mapping[str, str]:
        """Names of the effects that the plant can carry, each with one line about it."""
        return {}

    def parameters(self) -> Mapping[str, float]:
        """Names that ``--set`` takes, with their default values (SI)."""
        return {}

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or, where standard input is a pipe, its end.

        Raises UsageError or UnknownNameError for options that make no twin, before anything is opened.
        """
        from labhil.plants.arm.links import UR5
        from labhil_sim_ur5.arm import IdealArm
        from labhil_sim_ur5.controller import Controller
        from labhil_sim_ur5.dashboard import Dashboard
        from labhil_sim_ur5.kinematics import Geometry
        from labhil_sim_ur5.motion import Plan
        from labhil_sim_ur5.server import Server
        from labhil_sim_ur5.sidechannel import SideChannel
        from labhil_sim_ur5.variables import SERIES

        series = options.series or "e"
        if series not in SERIES:
            raise UnknownNameError("series", series, SERIES)
        if options.speed != 1.0:
            raise UsageError(f"the twin of a ur5 runs in real time only, found speed {options.speed:g}")
        home = Plan.resting((0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0))
        controller = Controller(SERIES[series], IdealArm(), Geometry.of(UR5), home, tell)
        host = options.host or DEFAULT_HOST
        with SideChannel() as side:
            server = Server(controller, Dashboard(controller, 20181234567, 0.0), host)
            try:
                ready(host)
                server.run(side, lambda line: None, lambda: None)
            finally:
                server.close()


def tell(message: str) -> None:
    """Say something to whoever started the twin."""
    print(message, file=sys.stderr, flush=True)


TWIN = Ur5Twin()
