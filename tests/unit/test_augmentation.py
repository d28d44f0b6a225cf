"""What the augmentation of photographs may change, and what it must keep."""

import torch
from torch.nn import functional

from pipeline.seeding import generator
from pipeline.training.augmentation import crop_and_mirror, to_float, turn


def random_images(count: int) -> torch.Tensor:
    return torch.randint(256, (count, 3, 8, 8), generator=generator(0, "images"), dtype=torch.uint8)


def test_every_result_is_a_crop_of_the_reflected_picture_or_its_mirror_image() -> None:
    images, margin = random_images(5), 2
    index = torch.tensor([4, 0, 2, 2, 1, 3] * 20)
    results = crop_and_mirror(images[index], margin, generator(0, "augmentation"))
    padded = functional.pad(images.float(), (margin,) * 4, mode="reflect").to(torch.uint8)
    seen = set()
    for source, result in zip(index.tolist(), results, strict=True):
        candidates = {
            (y, x, mirrored): crop.flip(2) if mirrored else crop
            for y in range(2 * margin + 1)
            for x in range(2 * margin + 1)
            for mirrored in (False, True)
            for crop in [padded[source, :, y : y + 8, x : x + 8]]
        }
        matches = [key for key, candidate in candidates.items() if torch.equal(candidate, result)]
        assert len(matches) == 1
        seen.add(matches[0])
    assert len(seen) > 30


def test_a_shift_beyond_the_picture_is_reflected_again() -> None:
    ramp = torch.arange(4, dtype=torch.uint8).expand(50, 3, 4, 4)
    steps = crop_and_mirror(ramp, 20, generator(0, "augmentation"))[..., 1:].int().diff(dim=-1)
    assert (steps.abs() == 1).all()


def test_the_same_generator_draws_the_same_batch() -> None:
    images = random_images(5)
    first, second = (crop_and_mirror(images, 2, generator(7, "augmentation")) for _ in range(2))
    assert torch.equal(first, second)


def test_turn_turns_each_picture_by_its_own_quarters() -> None:
    images = random_images(4)
    quarters = torch.tensor([3, 0, 1, 2])
    for image, count, turned in zip(images, quarters.tolist(), turn(images, quarters), strict=True):
        assert torch.equal(turned, image.rot90(count, (1, 2)))


def test_to_float_maps_bytes_onto_the_unit_interval() -> None:
    values = to_float(torch.tensor([0, 51, 255], dtype=torch.uint8)[:, None, None, None].expand(3, 3, 8, 8))
    torch.testing.assert_close(values[:, 0, 0, 0], torch.tensor([0.0, 0.2, 1.0]))
