"""The report's picture sections: base shapes, reconstructions, steps around objects."""

from collections.abc import Mapping, Sequence
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.evaluation.artifacts import STATES, Reconstructions, render_tuned
from pipeline.export.picture import data_uri, strip
from pipeline.export.report_page import Section, card, four, grid, image
from pipeline.export.seam import Seam, cut_open
from pipeline.export.viewer import turn_link
from pipeline.export.views import SEED_AZIMUTHS, ViewConfig, render_clay, render_textured
from pipeline.geometry.camera import CameraConfig
from pipeline.networks.pose_coordinates import Framing
from pipeline.rendering.renderer import RendererConfig

STEP_AZIMUTHS = tuple(range(0, 400, 50))
CORNER_AZIMUTHS = SEED_AZIMUTHS[1], SEED_AZIMUTHS[3]


class Gallery:
    """Renders the reconstructions of a run: as the photographs show them, and from other sides."""

    def __init__(
        self,
        reconstructions: Reconstructions,
        photographs: Float[Tensor, "B 3 H W"],
        camera: CameraConfig,
        framing: Framing,
        view: ViewConfig,
    ) -> None:
        self.photographs = photographs
        self.reconstructions = reconstructions
        self.elevation, self.size = view.elevation, view.size
        self._camera = camera
        self._framing: Framing = framing
        self._view = view

    @cached_property
    def seam(self) -> Seam:
        """Where all meshes of the run are cut open."""
        return cut_open(self.reconstructions.faces, self.reconstructions.directions)

    def seed_views(self, seeds: Float[Tensor, "S V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "S 4 4 H W"]:
        """Render every seed's base shape in grey from four sides."""
        return torch.stack([render_clay(one, faces, SEED_AZIMUTHS, self._camera, self._view) for one in seeds])

    def renderings(self, index: Int[Tensor, " K"], other_view: float) -> Float[Tensor, "K 3 3 H W"]:
        """Return the reconstruction, the fine-tuned one, and the latter from `other_view` degrees further round."""
        found = self.reconstructions
        others = self._other_view(index, other_view)
        return torch.stack([found.predicted.images[index], found.tuned.images[index], others], dim=1)

    def steps(self, index: int) -> Float[Tensor, "K 4 H W"]:
        """Render one fine-tuned object at steps of 50 degrees."""
        found = self.reconstructions
        return self._around(found.tuned.vertices[index], found.textures[index], STEP_AZIMUTHS)

    def corners(self, index: int) -> Float[Tensor, "3 4 H W"]:
        """Render one fine-tuned object from its front corner, its rear corner and, in grey, its front corner again."""
        vertices, faces = self.reconstructions.tuned.vertices[index], self.reconstructions.faces
        textured = self._around(vertices, self.reconstructions.textures[index], CORNER_AZIMUTHS)
        return torch.cat([textured, render_clay(vertices, faces, CORNER_AZIMUTHS[:1], self._camera, self._view)])

    def base_view(self, base: Float[Tensor, "V 3"], azimuth: float) -> Float[Tensor, "4 H W"]:
        """Render the base shape with the mean of all textures from one side."""
        return self._around(base, self.reconstructions.textures.mean(0), [azimuth])[0]

    def _around(
        self, vertices: Float[Tensor, "V 3"], texture: Float[Tensor, "3 T T"], azimuths: Sequence[float]
    ) -> Float[Tensor, "K 4 H W"]:
        found = self.reconstructions
        return render_textured(vertices, found.faces, found.directions, texture, azimuths, self._camera, self._view)

    def _other_view(self, index: Int[Tensor, " K"], turn: float) -> Float[Tensor, "K 3 H W"]:
        pose = self.reconstructions.tuned.pose.at(index)
        pose = pose._replace(azimuth=pose.azimuth + torch.tensor(turn).deg2rad())
        size = self.photographs.shape[-1]
        renderer = RendererConfig(camera=self._camera, size=size, supersampling=self._view.supersampling)
        return render_tuned(self.reconstructions, index, pose, self._framing, renderer)


def base_shape_section(views: Float[Tensor, "S 4 4 H W"], captions: Sequence[str], chosen: int) -> Section:
    """Show the base shapes of all seeds, the chosen one marked."""
    items = []
    for seed, (row, caption) in enumerate(zip(views, captions, strict=True)):
        picture = image(data_uri(strip(row)), f"base shape of seed {seed} from four sides")
        linked = f"{caption} · {turn_link(f'seed-{seed}')}"
        items.append(card(picture, linked, "chosen" if seed == chosen else ""))
    introduction = (
        "One base shape a seed, seen from the front, the front corner, the side and the rear corner; which end is "
        "called the front is arbitrary. The score is the distance of fresh renderings from the photographs in feature "
        "space: no label takes part in it, and the lowest is chosen unless params.yaml names a seed (chosen, under "
        "base_shapes)."
    )
    return Section("base-shapes", "Base shapes", introduction, grid("seeds", items))


def seed_captions(scores: Float[Tensor, " S"], chosen: int) -> list[str]:
    """Say every seed's score, and which one was chosen, as HTML."""
    captions = [f"seed {seed} · score {score:.4f}" for seed, score in enumerate(scores.tolist())]
    captions[chosen] += " <b>chosen</b>"
    return captions


def example_section(
    anchor: str,
    heading: str,
    gallery: Gallery,
    index: Int[Tensor, " K"],
    table: Mapping[str, list[str]],
    other_view: float,
) -> Section:
    """Show photographs beside their reconstructions, with the feature distance before and after fine-tuning."""
    names = ["photograph", "reconstruction", "fine-tuned", "other view"]
    items = []
    for position, renderings in zip(index.tolist(), gallery.renderings(index, other_view), strict=True):
        pictures = [gallery.photographs[position], *renderings]
        title = f"test picture {table['test_index'][position]}"
        caption = f"{title} · {example_figures(table, position)} · {turn_link(f'{anchor}-{position}')}"
        items.append(card(four([data_uri(picture) for picture in pictures], names, title), caption))
    introduction = (
        f"The other view is the fine-tuned object turned by {other_view:g} degrees. "
        "Distances are in feature space, before and after fine-tuning, and so are the angles by which a pose is wrong, "
        "where the true one is known."
    )
    return Section(anchor, heading, introduction, grid("examples", items))


def example_figures(table: Mapping[str, list[str]], position: int) -> str:
    """Say a picture's feature distance and, where it is known, its pose's error, before and after fine-tuning."""
    distances = [f"{float(table[f'feature_distance_{state}'][position]):.1f}" for state in STATES]
    figures = f"distance {' → '.join(distances)}"
    if "rotation_error_predicted" in table:
        figures += f" · {' → '.join(_pose_error(table, position, state) for state in STATES)}"
    return figures


def _pose_error(table: Mapping[str, list[str]], position: int, state: str) -> str:
    error, mode = float(table[f"rotation_error_{state}"][position]), table[f"error_mode_{state}"][position]
    return f"{error:.0f}° off ({mode.replace('_', ' for ')})"


def step_section(gallery: Gallery, index: Int[Tensor, " K"], numbers: Sequence[str]) -> Section:
    """Show fine-tuned objects in steps of 50 degrees; `numbers` are the pictures' places in the test split."""
    strips = []
    for position in index.tolist():
        steps = data_uri(strip(gallery.steps(position)))
        described = f"test picture {numbers[position]} at steps of 50 degrees"
        strips.append(f'<div class="strip" tabindex="0">{image(steps, described)}</div>')
    introduction = "Random fine-tuned reconstructions, each turned by 50 degrees from picture to picture."
    return Section("steps", "Steps of 50 degrees", introduction, "".join(strips))
