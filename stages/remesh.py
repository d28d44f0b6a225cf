"""Make the polygons of the base shape uniform and map it to the sphere (paper 3.1.7)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.config import load
from pipeline.errors import MeshError
from pipeline.files import write_json
from pipeline.geometry.mapped_mesh import MappedMesh
from pipeline.geometry.mesh_quality import measure_remeshing
from pipeline.geometry.remeshing import IsotropicConfig, remesh_isotropic
from pipeline.geometry.sphere_map import SphereMapConfig
from pipeline.networks.seed_choice import choose_seed
from pipeline.tensor_files import load_tensors, save_tensors
from pipeline.training.remesh_silhouette import SilhouetteConfig, remesh_by_silhouettes
from stages.command_line import parse, run


@dataclass(frozen=True)
class RemeshConfig:
    """Settings of the stage."""

    method: Literal["isotropic", "silhouette"]
    """Remesh the surface itself, or fit a sphere to its silhouettes as the paper does."""
    isotropic: IsotropicConfig
    sphere_map: SphereMapConfig
    silhouette: SilhouetteConfig


def main() -> None:
    """Remesh the chosen base shape; write the new mesh, with its seed, and how it compares with the old one."""
    arguments = parse(__doc__, base_shape=Path, chosen=str, out=Path, metrics=Path)
    config = load(arguments.params, RemeshConfig, arguments.sections)
    tensors, _ = load_tensors(arguments.base_shape)
    chosen = choose_seed(arguments.chosen, tensors["seed_scores"].tolist(), arguments.base_shape.stem)
    base_shape = MappedMesh(tensors["seed_vertices"][chosen], tensors["faces"], tensors["directions"])
    try:
        remeshed = remesh(base_shape, config)
    except MeshError as error:
        raise MeshError(f"{arguments.base_shape}, base shape {chosen}: {error}") from None
    metrics = measure_remeshing(base_shape, remeshed)
    save_tensors(arguments.out, remeshed._asdict(), {"seed": str(chosen)})
    write_json(arguments.metrics, metrics)


def remesh(base_shape: MappedMesh, config: RemeshConfig) -> MappedMesh:
    """Remesh in the configured way."""
    if config.method == "isotropic":
        return remesh_isotropic(base_shape, config.isotropic, config.sphere_map)
    return remesh_by_silhouettes(base_shape, config.silhouette)


if __name__ == "__main__":
    run(main)
