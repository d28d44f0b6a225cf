"""A headless Chromium."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")
# No sandbox: continuous integration runs as root. SwiftShader: WebGL without a graphics card. No calls home.
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    """Start Chromium; without one, skip, or fail where KATO3D_BROWSER_REQUIRED is set."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        advice = "no Chromium on PATH: install one, on Debian with `apt-get install chromium`"
        if "KATO3D_BROWSER_REQUIRED" in os.environ:
            pytest.fail(advice)
        pytest.skip(advice)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=Path(program), args=FLAGS)
        yield browser
        browser.close()
