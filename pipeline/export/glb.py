"""Textured meshes as binary glTF 2.0: one file that browsers and 3D programs open."""

import json
import struct
from pathlib import Path
from typing import Any

from jaxtyping import Float, Shaped
from torch import Tensor

from pipeline.export.picture import encode_png
from pipeline.export.seam import UnwrappedMesh
from pipeline.files import atomic_path

FLOAT, UNSIGNED_INT = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
LINEAR, REPEAT, CLAMP_TO_EDGE = 9729, 10497, 33071


def write_glb(path: Path, mesh: UnwrappedMesh, texture: Float[Tensor, "3 T T"]) -> None:
    """Write mesh and texture into one file, atomically; the same mesh gives the same bytes.

    glTF has the project's axes: y up, front towards +z. The material is unlit, for the texture holds the shading.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(encode_glb(mesh, texture))


def encode_glb(mesh: UnwrappedMesh, texture: Float[Tensor, "3 T T"]) -> bytes:
    """Encode mesh and texture as the bytes of a .glb file."""
    blocks = [_bytes(mesh.vertices), _bytes(mesh.normals), _bytes(mesh.uv), _bytes(mesh.faces.int())]
    blocks.append(encode_png(texture))
    padded = [block + b"\0" * (-len(block) % 4) for block in blocks]
    starts = [sum(map(len, padded[:index])) for index in range(len(blocks))]
    targets = [*[{"target": ARRAY_BUFFER}] * 3, {"target": ELEMENT_ARRAY_BUFFER}, {}]
    document = _document(mesh) | {
        "buffers": [{"byteLength": sum(map(len, padded))}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(block), **target}
            for start, block, target in zip(starts, blocks, targets, strict=True)
        ],
    }
    text = json.dumps(document, separators=(",", ":"), sort_keys=True).encode()
    chunks = _chunk(b"JSON", text + b" " * (-len(text) % 4)) + _chunk(b"BIN\0", b"".join(padded))
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _document(mesh: UnwrappedMesh) -> dict[str, Any]:
    """Describe the scene; accessor and buffer view i hold block i."""
    bounds = {"min": mesh.vertices.amin(dim=0).tolist(), "max": mesh.vertices.amax(dim=0).tolist()}
    count = len(mesh.vertices)
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    return {
        "asset": {"version": "2.0", "generator": "kato3d"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "textures": [{"sampler": 0, "source": 0}],
        "images": [{"bufferView": 4, "mimeType": "image/png"}],
        "samplers": [{"magFilter": LINEAR, "minFilter": LINEAR, "wrapS": REPEAT, "wrapT": CLAMP_TO_EDGE}],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": count, "type": "VEC3", **bounds},
            {"bufferView": 1, "componentType": FLOAT, "count": count, "type": "VEC3"},
            {"bufferView": 2, "componentType": FLOAT, "count": count, "type": "VEC2"},
            {"bufferView": 3, "componentType": UNSIGNED_INT, "count": mesh.faces.numel(), "type": "SCALAR"},
        ],
    }


def _bytes(values: Shaped[Tensor, "N C"]) -> bytes:
    return values.contiguous().numpy().tobytes()


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<I4s", len(content), kind) + content
