"""Textured meshes as Wavefront OBJ, readable by nearly every 3D program."""

from collections.abc import Sequence
from pathlib import Path

from jaxtyping import Float, Shaped
from torch import Tensor

from pipeline.export.picture import write_png
from pipeline.export.seam import UnwrappedMesh
from pipeline.files import write_text


def write_obj(path: Path, mesh: UnwrappedMesh, texture: Float[Tensor, "3 T T"]) -> None:
    """Write `path` and beside it a material and `*_texture.png`.

    Axes are the project's: y up, front towards +z. The material is unlit, for the texture holds the shading. Files are
    written one after the other, the mesh that names the others last, each atomically.
    """
    material, picture = path.with_suffix(".mtl"), path.with_name(f"{path.stem}_texture.png")
    write_png(picture, texture)
    _write_lines(material, ["newmtl texture", "illum 0", "Ka 1 1 1", "Kd 1 1 1", f"map_Kd {picture.name}"])
    uv = mesh.uv * mesh.uv.new_tensor([1.0, -1.0]) + mesh.uv.new_tensor([0.0, 1.0])
    _write_lines(
        path,
        [
            f"mtllib {material.name}",
            "usemtl texture",
            _rows("v %.6f %.6f %.6f", mesh.vertices),
            _rows("vt %.6f %.6f", uv),
            _rows("vn %.6f %.6f %.6f", mesh.normals),
            _rows("f %d/%d/%d %d/%d/%d %d/%d/%d", (mesh.faces + 1).repeat_interleave(3, dim=1)),
        ],
    )


def _rows(template: str, values: Shaped[Tensor, "N C"]) -> str:
    """Write all rows by one template, several times faster than one by one."""
    return "\n".join([template] * len(values)) % tuple(values.flatten().tolist())


def _write_lines(path: Path, lines: Sequence[str]) -> None:
    write_text(path, "\n".join(lines) + "\n")
