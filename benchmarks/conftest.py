"""Keep of a benchmark's JSON what is worth comparing, and print the figures that goals are set for."""

from typing import Any

import pytest
import torch

MEASURED = ("gpu_seconds", "floors", "share_outside_networks", "two_processes_over_one")
"""In a benchmark's `extra_info`: what goals are set for where it is not the time of a call."""
_LINES = pytest.StashKey[list[str]]()


def pytest_benchmark_update_json(config: pytest.Config, output_json: dict[str, Any]) -> None:
    """Leave out single times; say which hardware and libraries were measured."""
    machine = output_json["machine_info"]
    output_json["machine_info"] = {
        "cpu": machine["cpu"].get("brand_raw", machine["machine"]),
        "cores": machine["cpu"]["count"],
        "python": machine["python_version"],
        "torch": torch.__version__,
        "torch_threads": torch.get_num_threads(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
    }
    for benchmark in output_json["benchmarks"]:
        benchmark["stats"].pop("data", None)
    config.stash[_LINES] = [_figures(benchmark) for benchmark in output_json["benchmarks"]]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print what goals are set for; the goals stand in README.md and docs/gpu.md."""
    if lines := config.stash.get(_LINES, []):
        terminalreporter.section("figures that goals are set for")
        for line in lines:
            terminalreporter.write_line(line)


def _figures(benchmark: dict[str, Any]) -> str:
    measured = {name: benchmark["extra_info"][name] for name in MEASURED if name in benchmark["extra_info"]}
    others = "".join(f", {name} {value}" for name, value in measured.items())
    return f"{benchmark['name']}: median {benchmark['stats']['median']:.5f} s{others}"
