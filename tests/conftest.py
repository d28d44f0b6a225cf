"""Triton's kernels run on a GPU where there is one, else in Triton's interpreter: chosen before they are imported."""

import os

import pytest
import torch

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"


@pytest.fixture(autouse=True)
def same_draws() -> None:
    """Let draws without a generator be the same in every run, whichever tests came before."""
    torch.manual_seed(0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put slow tests first, so that processes that share the tests end together."""
    items.sort(key=lambda item: "slow" not in item.keywords)
