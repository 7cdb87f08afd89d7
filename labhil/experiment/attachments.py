"""What a recording of a run holds besides samples and events: the files it was made from, and metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from labhil.experiment.plan import DevicePlan, Plan
from labhil.recording.rig_attachments import rig_attachments


def attach_rigs(devices: Sequence[DevicePlan]) -> dict[str, bytes]:
    """Return the rig files of devices, by name; those of the first device have no prefix."""
    attachments: dict[str, bytes] = {}
    for index, device in enumerate(devices):
        attachments |= rig_attachments(device.rig, device.name if index else None)
    return attachments


def attach_files(plan: Plan) -> dict[str, bytes]:
    """Return the experiment file, without what a simulated device is made of, and the rig files, by name."""
    return {"experiment.toml": plan.experiment.public_text().encode(), **attach_rigs(plan.devices)}


def run_metadata(plan: Plan, extra: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
    """Return the metadata of a run: the table ``experiment``, and the ``extra`` tables."""
    section = plan.experiment.experiment
    experiment = {"name": section.name, "duration": repr(plan.duration)}
    for key, value in section.metadata().items():
        if value:
            experiment[key] = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return {"experiment": experiment, **{name: dict(table) for name, table in extra.items()}}
