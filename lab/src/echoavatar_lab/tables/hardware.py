"""The name of the hardware, for the notes of tables and for the table of latencies."""

import os
import platform
from pathlib import Path

import torch


def hardware(device: str) -> str:
    """The name of the GPU, or of the processor with its cores."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    return f"{_processor()} ({torch.get_num_threads()} of {os.cpu_count()} cores)"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
