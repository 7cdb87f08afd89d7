"""Pages of fresh results, with the pictures that need the samples."""

from __future__ import annotations

from pathlib import Path

from labhil.analysis.schema import ComparisonPart, DiagnosisPart, FitPart, VerificationPart
from labhil.analysis.study import DiagnosisResult, FitResult
from labhil.diagnose.locate import HeldOut
from labhil.physics.terms import keyed
from labhil.report.fit_plot import fit_figure
from labhil.report.html.diagnosis import diagnosis_page
from labhil.report.html.element import Markup
from labhil.report.html.fit import fit_page
from labhil.report.html.page import write_page
from labhil.report.html.picture import Album
from labhil.report.html.term_switches import term_switches
from labhil.report.plots import channel_figure, diagnosis_figure, worst_output


def write_fit_page(result: FitResult, path: Path) -> None:
    """Write the page of a fit; UsageError when the file cannot be written."""
    album = Album()
    caption = (
        "For each channel: simulated windows beside the measurement, their errors with the noise floor, the "
        "distribution of the errors, and the autocorrelation of the fitted residuals."
    )
    drawn = album.picture(caption, lambda: fit_figure(result.fit, result.dataset.test, columns=2))
    part = result.part
    write_page(fit_page(part, foot_of(part), album, (drawn,)), path)


def write_diagnosis_page(result: DiagnosisResult, path: Path) -> None:
    """Write the page of a diagnosis; UsageError when the file cannot be written."""
    album = Album()
    caption = (
        "Windows simulated before and after, their errors over time with the noise floor, each missing "
        "effect over the coordinate that reveals it, and the distribution of the errors."
    )
    diagnosis = result.diagnosis
    drawn = [album.picture(caption, lambda: diagnosis_figure(diagnosis))]
    others = [j for j in range(len(diagnosis.after.channels)) if j != worst_output(diagnosis)]
    drawn += [_channel_picture(album, result, j) for j in others]
    held_out = HeldOut(diagnosis.held_out, diagnosis.before, diagnosis.after)
    switched = term_switches(diagnosis.final_fit, diagnosis.named, held_out, album)
    drawn += [] if switched is None else [switched]
    part = result.part
    write_page(diagnosis_page(part, foot_of(part), album, drawn), path)


def _channel_picture(album: Album, result: DiagnosisResult, j: int) -> Markup:
    """Simulation and errors of one more channel."""
    channel = result.diagnosis.after.channels[j]
    caption = f"The same windows and their errors at {keyed(channel.channel, channel.joint)}."
    return album.picture(caption, lambda: channel_figure(result.diagnosis, j))


def foot_of(result: FitPart | DiagnosisPart | VerificationPart | ComparisonPart) -> str:
    """Return the last line of a page: the recordings that it comes from."""
    return f"Made from {', '.join(source.path for source in result.recordings)}."
