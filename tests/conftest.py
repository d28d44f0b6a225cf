"""Triton's kernels run on a GPU where there is one, else in Triton's interpreter: chosen before they are imported."""

import os
from collections.abc import Iterator

import pytest
import torch

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"


@pytest.fixture(scope="session", autouse=True)
def site_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what DVC notes of throw-away projects out of the machine's own folders."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DVC_SITE_CACHE_DIR", str(tmp_path_factory.mktemp("dvc")))
        yield


@pytest.fixture(autouse=True)
def same_draws() -> None:
    """Let draws without a generator be the same in every run, whichever tests came before."""
    torch.manual_seed(0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put slow tests first, so that processes that share the tests end together."""
    items.sort(key=lambda item: "slow" not in item.keywords)
