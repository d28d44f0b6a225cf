import numpy as np
import pytest
from PIL import Image

from tests.golden.golden_pictures import FOLDER, VIEWS, draw

TOLERANCE = 2
"""Of 255 grey levels: room for rounding, none for a change one could see."""


@pytest.mark.parametrize("view", VIEWS)
def test_picture_is_as_it_was(view: str) -> None:
    expected = np.asarray(Image.open(FOLDER / f"{view}.png")).astype(int)
    difference = np.abs(draw(view).numpy().astype(int) - expected)
    assert difference.max() <= TOLERANCE
