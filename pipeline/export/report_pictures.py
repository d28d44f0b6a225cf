"""The report's picture sections: base shapes, reconstructions, turntables."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.evaluation.artifacts import Reconstructions
from pipeline.export.picture import data_uri, strip
from pipeline.export.report_page import Section, card, four, grid, image, turntable
from pipeline.export.views import SEED_AZIMUTHS, ViewConfig, render_clay, render_textured
from pipeline.geometry.camera import CameraConfig
from pipeline.rendering.renderer import Mesh, RendererConfig, render

STEP_AZIMUTHS = tuple(range(0, 400, 50))


class Gallery:
    """Renders the reconstructions of a run: as the photographs show them, and from other sides."""

    def __init__(
        self,
        reconstructions: Reconstructions,
        photographs: Float[Tensor, "B 3 H W"],
        camera: CameraConfig,
        view: ViewConfig,
    ) -> None:
        self.photographs = photographs
        self._reconstructions = reconstructions
        self._camera = camera
        self._view = view

    def seed_views(self, seeds: Float[Tensor, "S V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "S 4 4 H W"]:
        """Render every seed's base shape in grey from four sides."""
        return torch.stack([render_clay(one, faces, SEED_AZIMUTHS, self._camera, self._view) for one in seeds])

    def renderings(self, index: Int[Tensor, " K"], other_view: float) -> Float[Tensor, "K 3 3 H W"]:
        """Return the reconstruction, the fine-tuned one, and the latter from `other_view` degrees further round."""
        found = self._reconstructions
        others = self._other_view(index, other_view)
        return torch.stack([found.predicted.images[index], found.tuned.images[index], others], dim=1)

    def steps(self, index: int) -> Float[Tensor, "K 4 H W"]:
        """Render one fine-tuned object at steps of 50 degrees."""
        found = self._reconstructions
        return self._around(found.tuned.vertices[index], found.textures[index], STEP_AZIMUTHS)

    def turn(self, index: int, frames: int) -> Float[Tensor, "K 4 H W"]:
        """Render one fine-tuned object all around."""
        found = self._reconstructions
        return self._around(found.tuned.vertices[index], found.textures[index], _full_turn(frames))

    def base_turn(self, base: Float[Tensor, "V 3"], frames: int) -> Float[Tensor, "K 4 H W"]:
        """Render the base shape with the mean of all textures all around."""
        return self._around(base, self._reconstructions.textures.mean(0), _full_turn(frames))

    def _around(
        self, vertices: Float[Tensor, "V 3"], texture: Float[Tensor, "3 T T"], azimuths: Sequence[float]
    ) -> Float[Tensor, "K 4 H W"]:
        found = self._reconstructions
        return render_textured(vertices, found.faces, found.directions, texture, azimuths, self._camera, self._view)

    @torch.no_grad()
    def _other_view(self, index: Int[Tensor, " K"], turn: float) -> Float[Tensor, "K 3 H W"]:
        found = self._reconstructions
        size = self.photographs.shape[-1]
        mesh = Mesh(found.tuned.vertices[index], found.faces, found.directions)
        pose = type(found.tuned.pose)(*(values[index] for values in found.tuned.pose))
        pose = pose._replace(azimuth=pose.azimuth + torch.tensor(turn).deg2rad())
        renderer = RendererConfig(camera=self._camera, size=size, supersampling=self._view.supersampling)
        images = render(mesh, found.textures[index], pose, found.tuned.backgrounds[index], None, renderer).images
        return images.clamp(0, 1)


def base_shape_section(views: Float[Tensor, "S 4 4 H W"], scores: Float[Tensor, " S"]) -> Section:
    """Show the base shapes of all seeds, the chosen one marked."""
    chosen = int(scores.argmin())
    items = []
    for seed, (row, score) in enumerate(zip(views, scores.tolist(), strict=True)):
        mark = " <b>chosen</b>" if seed == chosen else ""
        picture = image(data_uri(strip(row)), f"base shape of seed {seed} from four sides")
        items.append(card(picture, f"seed {seed} · score {score:.4f}{mark}", "chosen" if seed == chosen else ""))
    introduction = (
        "One base shape a seed, seen from the front, the front corner, the side and the rear corner. "
        "The score is the distance of fresh renderings from the photographs in feature space: no label takes part in "
        "it, and the lowest is chosen."
    )
    return Section("base-shapes", "Base shapes", introduction, grid("seeds", items))


def example_section(
    anchor: str,
    heading: str,
    gallery: Gallery,
    index: Int[Tensor, " K"],
    table: Mapping[str, list[str]],
    other_view: float,
) -> Section:
    """Show photographs beside their reconstructions, with the feature distance before and after fine-tuning."""
    names = ["input", "reconstruction", "fine-tuned", "other view"]
    items = []
    for position, renderings in zip(index.tolist(), gallery.renderings(index, other_view), strict=True):
        pictures = [gallery.photographs[position], *renderings]
        before, after = (float(table[f"feature_distance_{stage}"][position]) for stage in ("predicted", "tuned"))
        caption = f"test picture {table['test_index'][position]} · distance {before:.3f} → {after:.3f}"
        if "rotation_error_predicted" in table:
            error = float(table["rotation_error_predicted"][position])
            caption += f" · {error:.0f}° off ({table['error_mode_predicted'][position].replace('_', ' ')})"
        items.append(card(four([data_uri(picture) for picture in pictures], names), caption))
    introduction = (
        f"The other view is the fine-tuned object turned by {other_view:g} degrees. "
        "Distances are in feature space, before and after fine-tuning."
    )
    return Section(anchor, heading, introduction, grid("examples", items))


def turn_section(
    gallery: Gallery, index: Int[Tensor, " K"], base: Float[Tensor, "V 3"], numbers: Sequence[str], frames: int
) -> Section:
    """Show the base shape and objects to turn by hand, and the objects in steps of 50 degrees.

    `numbers` are the pictures' places in the test split.
    """
    base_sheet = data_uri(strip(gallery.base_turn(base, frames)))
    tables, strips = [card(turntable(base_sheet, frames, "base shape all around"), "base shape, mean texture")], []
    for position in index.tolist():
        name = f"test picture {numbers[position]}"
        sheet = data_uri(strip(gallery.turn(position, frames)))
        tables.append(card(turntable(sheet, frames, f"{name} all around"), name))
        steps = data_uri(strip(gallery.steps(position)))
        strips.append(f'<div class="strip">{image(steps, f"{name} at steps of 50 degrees")}</div>')
    introduction = (
        "The base shape and fine-tuned reconstructions from all around: drag a picture or its slider, or read the "
        "strips of 50 degrees."
    )
    return Section("turntables", "Turntables", introduction, grid("tables", tables) + "".join(strips))


def _full_turn(frames: int) -> list[float]:
    return [360 * frame / frames for frame in range(frames)]
