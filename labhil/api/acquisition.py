"""Acquisition: ``connect`` for one device, ``Experiment`` and ``run`` for scripted recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from labhil.api.inputs import PathLike, path_of, rig_file
from labhil.errors import ExperimentFileError, RunError, UsageError
from labhil.experiment.bench import Bench
from labhil.experiment.device_sections import DeviceSection, TwinSection, WithDevices
from labhil.experiment.experiment import Experiment as ExperimentFile
from labhil.experiment.experiment import load_experiment
from labhil.experiment.hooks import load_hook
from labhil.experiment.plan import Plan, device_plan, make_plan
from labhil.experiment.points import is_campaign, points_of
from labhil.rig import RigFile
from labhil.validation_errors import format_validation_error, reason_of

if TYPE_CHECKING:
    from labhil.api.model import Model
    from labhil.api.python_plan import PlanResult, PythonPlan
    from labhil.api.recording import Recording
    from labhil.experiment.campaign import CampaignResult
    from labhil.experiment.result import Progress, RunResult

DEVICE_NAME = "bench"
RunProgress = bool | Callable[["Progress"], None] | None


def connect(
    driver: str,
    address: str = "twin",
    *,
    rig: PathLike | Model | RigFile | None = None,
    twin: Mapping[str, Any] | None = None,
) -> Bench:
    """Connect to a device, under its host's limits and watchdog.

    Args:
        driver: A name of ``labhil devices``, such as ``"ball_beam"``.
        address: ``"/dev/ttyACM0"``, ``"socket://host:port"`` or an IP address; ``"twin"`` starts a simulated
            device and stops it afterwards.
        rig: The path of a rig file, or a model, with the ``[limits]``; by default there are none.
        twin: Settings of the simulated device: ``terms``, ``set``, ``seed``, ``speed``, …, as in an
            experiment file.

    Returns:
        The bench, to be used in a ``with`` statement: the device is safe when it ends, however it ends.

    Raises:
        UsageError: There is no such driver, or a setting of the twin is wrong.
        ConnectError: No device answers at the address; raised when the ``with`` statement begins.

    Example:
        >>> import labhil as lh
        >>> with lh.connect("dc_motor", "twin", twin={"seed": 1}) as bench:
        ...     applied = bench.command(voltage=2.0, hold=0.3)
        ...     sample = bench.read()
        >>> sample["speed"] > 0.0
        True
    """
    try:
        section = DeviceSection(plugin=driver, address=address, twin=TwinSection(**(twin or {})))
        devices = WithDevices(devices={DEVICE_NAME: section}, path=Path("labhil.connect"))
    except (ValidationError, TypeError) as error:
        raise UsageError(reason_of(error, Path("twin"), TwinSection)) from error
    plan, resolved_rig = device_plan(devices, DEVICE_NAME), rig_file(rig)
    if resolved_rig is not None and resolved_rig.kind.name != plan.spec.rig:
        raise UsageError(
            f"rig: expected one of kind {plan.spec.rig!r}, as {driver}, found {resolved_rig.kind.name!r}"
        )
    return Bench(plan if resolved_rig is None else replace(plan, rig=resolved_rig))


class Experiment:
    """A scripted acquisition: devices and the steps that move them. Immutable.

    Its arguments are the tables of an experiment file; :meth:`load` reads one.

    Example:
        >>> import labhil as lh
        >>> experiment = lh.Experiment(
        ...     "step", devices={"bench": {"plugin": "dc_motor", "address": "twin"}},
        ...     steps=[{"device": "bench", "signal": "voltage", "excitation": "hold", "level": 3.0,
        ...             "duration": 2.0}])
        >>> experiment.duration
        2.0
        >>> print(experiment.plan().splitlines()[0])
        step: 2 s of the devices' clocks
    """

    def __init__(
        self,
        name: str,
        *,
        devices: Mapping[str, Mapping[str, Any]],
        steps: Sequence[Mapping[str, Any]],
        seed: int = 0,
        about: Mapping[str, Any] | None = None,
        repeat: int = 1,
        sweep: Mapping[str, Any] | None = None,
        checks: Sequence[Mapping[str, Any]] = (),
        hook: str | None = None,
        record: Mapping[str, Any] | None = None,
        directory: PathLike = ".",
    ) -> None:
        """Describe an acquisition.

        Args:
            name: Its name.
            devices: ``plugin``, ``address`` and ``rig`` by the name of the device.
            steps: ``device``, ``signal``, ``excitation``, ``duration`` and the excitation's settings of each
                step.
            seed: Seed of all random numbers.
            about: ``operator``, ``sample``, ``notes`` and ``tags`` for the recording.
            repeat: Number of recordings of each run; see :meth:`run_all`.
            sweep: ``over``, values by key: ``{"over": {"steps.0.level": [1.0, 2.0]}}``.
            checks: ``condition``, ``at`` ("before" or "after" the steps) and ``within`` of each check.
            hook: A function that is called with a :class:`RunContext` before and after each run, such as
                ``"lab.py:tell"``.
            record: ``path``, the name of the recording's file.
            directory: The folder that relative paths start from.

        Raises:
            ExperimentFileError: A key is missing, misspelt or wrong.
        """
        path = path_of(directory, "directory") / "labhil.Experiment"
        data: dict[str, Any] = {
            "experiment": {**(about or {}), "name": name, "seed": seed, "repeat": repeat},
            "devices": devices,
            "steps": steps,
        }
        if record is not None:
            data["record"] = record
        if sweep is not None:
            data["sweep"] = sweep
        if checks:
            data["checks"] = checks
        if hook is not None:
            data["experiment"]["hook"] = hook
        try:
            self._file = ExperimentFile.model_validate({**data, "path": path})
        except ValidationError as error:
            raise ExperimentFileError(format_validation_error(error, path, ExperimentFile)) from error

    @classmethod
    def load(cls, path: PathLike) -> Experiment:
        """Read an experiment file.

        Args:
            path: The TOML file.

        Raises:
            ExperimentFileError: The file cannot be read, or a key is missing, misspelt or wrong.
        """
        experiment = cls.__new__(cls)
        experiment._file = load_experiment(path_of(path, "path"))
        return experiment

    @property
    def name(self) -> str:
        """Its name."""
        return self._file.experiment.name

    @property
    def duration(self) -> float:
        """Duration of its steps, s of the devices' clocks."""
        return self._file.duration

    @cached_property
    def _planned(self) -> Plan:
        return make_plan(self._file)

    def plan(self) -> str:
        """Return a description of the run, as ``labhil run --dry-run`` prints it, without using a device.

        The file of a hook is run, to find the function in it, and the function is not called.

        Raises:
            UsageError: It cannot be run: a driver, a signal or the hook does not exist, or a step exceeds a
                limit.
        """
        load_hook(self._file)
        if not self.is_campaign:
            return self._planned.describe()
        points = points_of(self._file)
        plans = [make_plan(point.experiment) for point in points]
        seconds = sum(plan.duration for plan in plans)
        total = f"{len(points)} runs, {seconds:g} s of the devices' clocks in all"
        runs = [f"  {point.describe()}" for point in points]
        return "\n".join([total, *runs, "the first of them:", plans[0].describe()])

    @property
    def is_campaign(self) -> bool:
        """Whether it has several recordings, by ``repeat`` or a sweep: see :meth:`run_all`."""
        return is_campaign(self._file)

    def run_all(
        self,
        out: PathLike = ".",
        *,
        progress: RunProgress = None,
        announce: Callable[[str], None] | None = None,
        anew: bool = False,
    ) -> CampaignResult:
        """Do every run of ``repeat`` and ``[sweep]`` that is not complete yet.

        The campaign file in ``out`` lists complete runs: an interrupted campaign is continued.

        Args:
            out: The folder for the recordings and the campaign file.
            progress: As for :meth:`execute`.
            announce: A function of a line about each run that begins.
            anew: Whether to begin an existing campaign again; its recordings stay.

        Returns:
            ``recordings``, ``path`` of the campaign file, ``exit_status``, ``error``.
        """
        from labhil.experiment.campaign import run_campaign

        with _progress_callback(progress) as report:
            return run_campaign(
                self._file, path_of(out, "out"), report, announce or (lambda _text: None), anew=anew
            )

    def run_plan(
        self, plan: Callable[[], PythonPlan], out: PathLike = ".", *, progress: RunProgress = None
    ) -> PlanResult:
        """Run the steps that a generator yields, and send it their recordings.

        Each yield is a run with this experiment's devices, checks and hook, and has its own recording; the
        steps of this experiment are not run. Yielded steps are checked against the limits before a device
        moves. Between two runs every device is in its safe state, and a simulated one starts again.

        Args:
            plan: A function without arguments that makes the generator. It yields a step, or a list of steps,
                as in ``steps``; with one device the name of the device may be left out. The value of
                ``yield`` is the :class:`Recording`. A run that fails raises its error there; a run that a
                person ends, and the emergency stop, end the plan.
            out: The folder for the recordings.
            progress: As for :meth:`execute`.

        Returns:
            ``recordings``, their paths, and ``value``, the return value of the generator.

        Raises:
            ExperimentFileError: Yielded steps cannot be run.
            RunError: A run failed, and the plan did not handle its error; its notes name the recordings.

        Example:
            >>> import tempfile
            >>> import labhil as lh
            >>> experiment = lh.Experiment(
            ...     "search", devices={"bench": {"plugin": "dc_motor", "address": "twin"}},
            ...     steps=[{"device": "bench", "signal": "voltage", "excitation": "hold", "level": 0.0,
            ...             "duration": 1.0}])
            >>> def find_break_away():
            ...     for level in (0.5, 4.0):
            ...         rec = yield {"signal": "voltage", "excitation": "hold", "level": level,
            ...                      "duration": 1.0}
            ...         if rec["speed"].max() > 1.0:
            ...             return level
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     result = experiment.run_plan(find_break_away, folder)
            >>> result.value, len(result.recordings)
            (4.0, 2)
        """
        from labhil.api.python_plan import run_plan

        with _progress_callback(progress) as report:
            return run_plan(self._file, plan, path_of(out, "out"), report)

    def run(self, out: PathLike = ".", *, progress: RunProgress = None) -> Recording:
        """Run it, and return the recording; see :func:`labhil.run`."""
        from labhil.api.recording import read

        result = self.execute(out, progress=progress)
        if result.error is not None:
            if result.path is not None:
                result.error.add_note(f"What was recorded until then: {result.path}")
            raise result.error
        if result.path is None:
            raise RunError(f"{self.name}: nothing was recorded: {result.reason}")
        return read(result.path)

    def execute(self, out: PathLike = ".", *, progress: RunProgress = None) -> RunResult:
        """Run it, and return its outcome; no error of the run is raised.

        Args:
            out: The folder for the recording.
            progress: A function of the progress of the run, or True for a bar on stderr.

        Returns:
            ``path`` of the recording, ``exit_status``, ``reason``, ``error``, ``streams``.
        """
        from labhil.experiment.run import run_experiment

        with _progress_callback(progress) as report:
            return run_experiment(self._file, path_of(out, "out"), report)

    def warnings(self) -> tuple[str, ...]:
        """Return warnings about its steps, a line each."""
        if not self.is_campaign:
            return self._planned.warnings()
        per_point = (make_plan(point.experiment).warnings() for point in points_of(self._file))
        return tuple(dict.fromkeys(warning for warnings in per_point for warning in warnings))

    def __repr__(self) -> str:
        devices = ", ".join(self._file.devices)
        steps = len(self._file.steps)
        counted = "1 step" if steps == 1 else f"{steps} steps"
        return f"<Experiment {self.name}: {counted}, {self.duration:g} s, on {devices}>"


@contextmanager
def _progress_callback(progress: RunProgress) -> Iterator[Callable[[Progress], None]]:
    """Yield the function of ``progress``."""
    if callable(progress):
        yield progress
    elif progress:
        from labhil.experiment.show import ProgressBar

        with ProgressBar() as bar:
            yield bar
    else:
        yield _ignore_progress


def _ignore_progress(progress: Progress) -> None:
    """Ignore progress."""


def run(experiment: PathLike | Experiment, out: PathLike = ".", *, progress: RunProgress = None) -> Recording:
    """Run the steps of an experiment, and return the recording.

    However it ends, every device is brought to its safe state first. Ctrl+C ends it, too.

    Args:
        experiment: The path of an experiment file, or an :class:`Experiment`.
        out: The folder for the recording.
        progress: A function of the progress of the run, or True for a bar on stderr.

    Returns:
        The recording.

    Raises:
        ExperimentFileError: The experiment cannot be run; nothing was started.
        RunError: A limit tripped, somebody stopped it, or a device failed; its notes name the recording.

    Example:
        >>> import tempfile
        >>> import labhil as lh
        >>> experiment = lh.Experiment(
        ...     "step", devices={"bench": {"plugin": "dc_motor", "address": "twin"}},
        ...     steps=[{"device": "bench", "signal": "voltage", "excitation": "hold", "level": 3.0,
        ...             "duration": 1.0}])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     rec = lh.run(experiment, folder)
        >>> print(rec["voltage"].max())
        3.0
    """
    loaded = experiment if isinstance(experiment, Experiment) else Experiment.load(experiment)
    return loaded.run(out, progress=progress)
