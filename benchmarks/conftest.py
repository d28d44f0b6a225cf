"""Keep of a benchmark's JSON what is worth comparing: the statistics, and the hardware and libraries behind them."""

from typing import Any

import torch


def pytest_benchmark_update_json(output_json: dict[str, Any]) -> None:
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
