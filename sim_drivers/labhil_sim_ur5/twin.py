"""The twin of the UR5: an arm with its controller and three ports, in real time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from labhil.driver import ReadyCallback, TwinOptions
from labhil.terminal import complain


class Ur5Twin:
    """A simulated UR5; satisfies :class:`labhil.driver.Twin`.

    It runs in real time only. Its ports are those of a controller (30004, 30003, 29999), so that several
    twins need several addresses of this machine.

    Args:
        name: Name of the twin.
        series: Default series of its controller.
    """

    rig = "ur5"

    def __init__(self, name: str = "ur5", series: str = "e") -> None:
        self.name, self._series = name, series
        self.description = (
            "simulated UR5 with its controller: RTDE, script upload and dashboard, 125 or 500 Hz;"
            f" series {series!r} unless told otherwise"
        )

    def terms(self) -> Mapping[str, str]:
        """Return the names of the plant's effects, each with a line about it."""
        from labhil.plants.arm.effects import EFFECTS

        return {name: effect.about for name, effect in EFFECTS.items()}

    def parameters(self) -> Mapping[str, float]:
        """Return the names of ``--set`` with their default values (SI); ``name[2]`` is that of joint 2."""
        from labhil_sim_ur5.settings import twin_parameters

        return twin_parameters()

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or, where standard input is a pipe, its end.

        Args:
            options: Options of the twin.
            ready: Called with the address when the twin listens.

        Raises:
            UsageError: An option is wrong (also as UnknownNameError); nothing was opened.
        """
        # imported here: compiling the plant takes time that a list of twins does not have
        from labhil.ending import Ending
        from labhil_sim_ur5.arm import PhysicalArm
        from labhil_sim_ur5.controller import Controller
        from labhil_sim_ur5.dashboard import Dashboard
        from labhil_sim_ur5.faults import Faults
        from labhil_sim_ur5.kinematics import Geometry
        from labhil_sim_ur5.motion import Plan
        from labhil_sim_ur5.server import Server
        from labhil_sim_ur5.settings import TwinSettings

        settings = TwinSettings.of(replace(options, series=options.series or self._series))
        arm = PhysicalArm(settings.plant, settings.terms, settings.seed)
        if options.answer is not None:
            settings.write_answer(options.answer, arm.parameters)
        controller = Controller(
            settings.version, arm, Geometry.from_links(arm.links), Plan.resting(settings.home), report
        )
        dashboard = Dashboard(controller, int(settings.robot.serial_number), settings.robot.unlock_after)
        with Ending() as ending:
            server = Server(controller, dashboard, settings.host)
            faults = Faults(settings.faults, server, controller)
            try:
                controller.tick()
                controller.publish()
                ready(settings.host)
                server.run(ending, faults.execute, faults.tick)
            finally:
                server.close()
                if server.missed_ticks or server.late_ticks:
                    report(
                        f"the machine was too slow: {server.missed_ticks} ticks left out, "
                        f"{server.late_ticks} too late"
                    )


def report(message: str) -> None:
    """Print a message on standard error."""
    complain(message)


TWIN = Ur5Twin()
CB3_TWIN = Ur5Twin("ur5_cb3", "cb3")
