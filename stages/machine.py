"""What a stage computes with, as params.yaml says."""

from pathlib import Path
from typing import NamedTuple

import torch

from pipeline.config import scalar
from pipeline.device import resolve_device, resolve_memory, resolve_precision


class Machine(NamedTuple):
    """Where a stage computes, with what numbers, and how much it may keep."""

    device: torch.device
    precision: torch.dtype
    """Of networks in training."""
    memory: int
    """Bytes a process for photographs and their kept features."""


def load_machine(params: Path) -> Machine:
    """Read `device`, `precision` and `memory` of the parameter file, and prepare this process for the device.

    Raises ConfigError where one is missing, or asks for what there is not.
    """
    device = resolve_device(scalar(params, "device"))
    precision = resolve_precision(scalar(params, "precision"), device)
    return Machine(device, precision, resolve_memory(scalar(params, "memory")))
