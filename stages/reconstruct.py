"""Turn single photographs into textured meshes with a trained model: GLB, and OBJ with its material and picture."""

from pathlib import Path

import torch

from pipeline.config import load
from pipeline.datasets.decoding import decode
from pipeline.datasets.folder import FolderConfig
from pipeline.errors import DataError
from pipeline.export.glb import write_glb
from pipeline.export.obj import write_obj
from pipeline.export.seam import unwrap
from pipeline.networks.full_model import FullModel, load_full_model
from stages.command_line import parse, run


def main() -> None:
    """Write the mesh of each photograph under the photograph's name."""
    arguments = parse(__doc__, model=Path, images=list[Path], out=Path)
    config = load(arguments.params, FolderConfig, arguments.sections)
    model = load_full_model(arguments.model, torch.device("cpu"))
    for path in arguments.images:
        reconstruct(model, path, config, arguments.out)


def reconstruct(model: FullModel, path: Path, config: FolderConfig, out: Path) -> None:
    """Write the mesh of one photograph."""
    if not path.is_file():
        raise DataError(f"{path} does not exist; give the path of a photograph")
    pixels = decode(path.read_bytes(), str(path), model.config.renderer.size, config.fit)
    found = model.infer(torch.from_numpy(pixels.copy()).permute(2, 0, 1)[None] / 255)
    texture = found.texture_maps[0]
    mesh = unwrap(found.vertices[0], model.faces, model.directions, texture.shape[-1])
    write_glb(out / f"{path.stem}.glb", mesh, texture)
    write_obj(out / f"{path.stem}.obj", mesh, texture)


if __name__ == "__main__":
    run(main)
