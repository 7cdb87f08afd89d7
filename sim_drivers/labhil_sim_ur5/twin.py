"""The twin: an arm behind a controller behind three ports, paced against the clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from labhil.driver import ReadyCallback, TwinOptions
from labhil.terminal import complain


class Ur5Twin:
    """A UR5 that is not there; satisfies :class:`labhil.driver.Twin`.

    It runs in real time only. Its address is one of this machine; the ports are the controller's own
    (30004, 30003, 29999), so that several twins need several addresses. ``series`` is its controller
    where the options name none.
    """

    rig = "ur5"

    def __init__(self, name: str = "ur5", series: str = "e") -> None:
        self.name, self._series = name, series
        self.description = (
            "simulated UR5 with its controller: RTDE, script upload and dashboard, 125 or 500 Hz;"
            f" series {series!r} unless told otherwise"
        )

    def terms(self) -> Mapping[str, str]:
        """Names of the effects that the plant can carry, each with one line about it."""
        from labhil.plants.arm.effects import EFFECTS

        return {name: effect.about for name, effect in EFFECTS.items()}

    def parameters(self) -> Mapping[str, float]:
        """Names that ``--set`` takes, with their default values (SI); ``name[2]`` is joint 2's."""
        from labhil_sim_ur5.settings import twin_parameters

        return twin_parameters()

    def serve(self, options: TwinOptions, ready: ReadyCallback) -> None:
        """Run until SIGINT, SIGTERM or, where standard input is a pipe, its end.

        Raises UsageError or UnknownNameError for options that make no twin, before anything is opened.
        """
        # compiling the plant takes a moment, and a list of twins must not
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
            settings.version, arm, Geometry.of(arm.links), Plan.resting(settings.home), tell
        )
        dashboard = Dashboard(controller, int(settings.robot.serial_number), settings.robot.unlock_after)
        with Ending() as ending:
            server = Server(controller, dashboard, settings.host)
            faults = Faults(settings.faults, server, controller)
            try:
                controller.tick()
                controller.publish()
                ready(settings.host)
                server.run(ending, faults.carry_out, faults.tick)
            finally:
                server.close()
                if server.missed or server.unsent:
                    tell(
                        f"the machine was too slow: {server.missed} ticks left out, {server.unsent} too late"
                    )


def tell(message: str) -> None:
    """Say something to whoever started the twin."""
    complain(message)


TWIN = Ur5Twin()
CB3_TWIN = Ur5Twin("ur5_cb3", "cb3")
