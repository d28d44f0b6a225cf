"""The meshes that the report's viewer shows: reconstructions, and base shapes of all seeds and after full training."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from pipeline.export.glb import encode_glb
from pipeline.export.picture import data_uri
from pipeline.export.report_page import captioned, grid, image
from pipeline.export.report_pictures import Gallery, example_figures
from pipeline.export.seam import UnwrappedMesh
from pipeline.export.viewer import Exhibit
from pipeline.export.views import CLAY, SEED_AZIMUTHS
from pipeline.rendering.lighting import vertex_normals

BASE_SHAPES = "Base shapes"
CORNER = 1
CORNER_AZIMUTH = SEED_AZIMUTHS[CORNER]


def reconstruction_exhibits(
    anchor: str, heading: str, gallery: Gallery, index: Int[Tensor, " K"], table: Mapping[str, list[str]]
) -> list[Exhibit]:
    """Show fine-tuned objects from their estimated viewpoints, beside the photographs and the renderings."""
    found = gallery.reconstructions
    exhibits = []
    for position in index.tolist():
        texture, pose = found.textures[position], found.tuned.pose
        mesh = gallery.seam.unwrap(found.tuned.vertices[position], texture.shape[-1])
        photograph = data_uri(gallery.photographs[position])
        pictures = [(photograph, "photograph"), (data_uri(found.tuned.images[position]), "fine-tuned")]
        exhibits.append(
            Exhibit(
                key=f"{anchor}-{position}",
                group=heading,
                name=f"picture {table['test_index'][position]}",
                glb=encode_glb(mesh, texture),
                textured=True,
                azimuth=pose.azimuth[position].rad2deg().item(),
                elevation=pose.elevation[position].rad2deg().item(),
                thumbnail=photograph,
                beside=grid("pair", [captioned(image(address, name, pixels=True), name) for address, name in pictures])
                + f"<p>{example_figures(table, position)}</p>",
            )
        )
    return exhibits


def base_exhibit(base: Float[Tensor, "V 3"], gallery: Gallery) -> Exhibit:
    """Show the base shape after full training, with the mean of all textures."""
    found = gallery.reconstructions
    texture = found.textures.mean(0)
    mesh = gallery.seam.unwrap(base, texture.shape[-1])
    return Exhibit(
        key="base",
        group=BASE_SHAPES,
        name="after full training",
        glb=encode_glb(mesh, texture),
        textured=True,
        azimuth=CORNER_AZIMUTH,
        elevation=gallery.elevation,
        thumbnail=data_uri(gallery.base_view(base, CORNER_AZIMUTH)),
        beside=f"<p>What every reconstruction deforms, with the mean of all textures. {len(found.faces)} polygons.</p>",
    )


def seed_exhibits(
    seeds: Float[Tensor, "S V 3"],
    faces: Int[Tensor, "F 3"],
    captions: Sequence[str],
    views: Float[Tensor, "S 4 4 H W"],
    elevation: float,
) -> list[Exhibit]:
    """Show the base shape of every seed in clay; `views` are those of the gallery, from `elevation` in degrees."""
    normals = vertex_normals(seeds, faces)
    texture, uv = torch.full((3, 1, 1), CLAY), torch.zeros(seeds.shape[1], 2)
    return [
        Exhibit(
            key=f"seed-{seed}",
            group=BASE_SHAPES,
            name=f"seed {seed}",
            glb=encode_glb(UnwrappedMesh(vertices, normals[seed], uv, faces), texture),
            textured=False,
            azimuth=CORNER_AZIMUTH,
            elevation=elevation,
            thumbnail=data_uri(views[seed, CORNER]),
            beside=f"<p>{captions[seed]} · before remeshing, {len(faces)} polygons</p>",
        )
        for seed, vertices in enumerate(seeds)
    ]
