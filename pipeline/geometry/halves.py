"""Cutting closed meshes in two disks, and putting mirror images together."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from pipeline.errors import MeshError
from pipeline.geometry.symmetry import mirror_index, reflect, symmetrize
from pipeline.geometry.topology import topology_of


def cut_half(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], directions: Float[Tensor, "V 3"]
) -> tuple[Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Return the half of a closed mesh whose directions have x >= 0: a disk with its border on the plane x = 0.

    `directions` are the vertices' mirror-symmetric points on the unit sphere. They say which side a vertex belongs to,
    even where a deformation pushed it across the plane. Positions are made symmetric; edges across the plane are cut in
    their middle. Raises MeshError when the faces are not mirror-symmetric.
    """
    mirror = mirror_index(directions)
    side = directions[:, 0].sign().masked_fill(mirror == torch.arange(len(mirror)), 0)
    face_side = side[faces]
    whole = faces[(face_side >= 0).all(dim=1)]
    straddling = (face_side.amin(dim=1) < 0) & (face_side.amax(dim=1) > 0)
    plane_corner = (face_side[straddling] == 0).long().argmax(dim=1, keepdim=True)
    apex, first, second = faces[straddling].gather(1, (plane_corner + torch.arange(3)) % 3).unbind(dim=1)
    if not torch.equal(mirror[first], second):
        raise MeshError("the faces are not mirror-symmetric about x = 0: expected a face on the plane to mirror itself")
    pairs, middle = torch.stack([first, second], dim=1).sort(dim=1).values.unique(dim=0, return_inverse=True)
    middle = middle + len(vertices)
    kept_first = side[first] > 0
    cut = torch.stack([apex, torch.where(kept_first, first, middle), torch.where(kept_first, middle, second)], dim=1)
    symmetric = symmetrize(vertices, mirror)
    used, half_faces = torch.cat([whole, cut]).unique(return_inverse=True)
    return torch.cat([symmetric, symmetric[pairs].mean(dim=1)])[used], half_faces


def join_halves(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]
) -> tuple[Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Weld a disk to its mirror image along its border, which is moved onto the plane x = 0.

    The first V vertices and F faces of the result are the disk's; the result is symmetric to the last bit.
    """
    on_border = border_mask(faces, len(vertices))
    x, rest = vertices.split([1, 2], dim=1)
    vertices = torch.cat([x.masked_fill(on_border[:, None], 0), rest], dim=1)
    partner = torch.arange(len(vertices))
    partner[~on_border] = len(vertices) + torch.arange(int((~on_border).sum()))
    return torch.cat([vertices, reflect(vertices[~on_border])]), torch.cat([faces, partner[faces].flip(1)])


def border_edges(faces: Int[Tensor, "F 3"]) -> Int[Tensor, "K 2"]:
    """List the edges of a mesh with one face only, in that face's sense of rotation."""
    vertex_count = int(faces.max()) + 1
    start, end = faces.flatten(), faces.roll(-1, dims=1).flatten()
    alone = ~torch.isin(start * vertex_count + end, end * vertex_count + start)
    return torch.stack([start[alone], end[alone]], dim=1)


def border_mask(faces: Int[Tensor, "F 3"], vertex_count: int) -> Bool[Tensor, " V"]:
    """Tell which vertices lie on the border of a disk."""
    mask = torch.zeros(vertex_count, dtype=torch.bool)
    mask[border_edges(faces)] = True
    return mask


def border_loop(faces: Int[Tensor, "F 3"]) -> Int[Tensor, " K"]:
    """Walk around the border of a disk in the sense of rotation of its faces.

    Raises MeshError when the border is not one simple loop.
    """
    edges = border_edges(faces).tolist()
    following = dict(edges)
    loop = [min(following, default=0)]
    while (vertex := following.get(loop[-1])) not in (None, loop[0]) and len(loop) <= len(following):
        loop.append(vertex)
    if not len(loop) == len(following) == len(edges):
        raise MeshError("half of the mesh is not a disk, expected a border of one loop: the mesh needs genus 0")
    return torch.tensor(loop)


def split_chords(
    vertices: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]
) -> tuple[Float[Tensor, "new_vertices 3"], Int[Tensor, "new_faces 3"]]:
    """Split every inner edge between two border vertices of a disk in its middle.

    Such an edge would coincide with its mirror image once halves are joined, and a face beside it could have all its
    corners on the border.
    """
    while True:
        on_border = border_mask(faces, len(vertices))
        start, end = faces.flatten(), faces.roll(-1, dims=1).flatten()
        border_key = border_edges(faces) @ torch.tensor([len(vertices), 1])
        chord = on_border[start] & on_border[end] & ~torch.isin(start * len(vertices) + end, border_key)
        if not chord.any():
            return vertices, faces
        ends = torch.stack([start, end], dim=1)[chord][0]
        beside = torch.isin(faces, ends).sum(dim=1) == 2
        middle = torch.tensor(len(vertices))
        halves = [torch.where(faces[beside] == replaced, middle, faces[beside]) for replaced in ends]
        vertices = torch.cat([vertices, vertices[ends].mean(dim=0, keepdim=True)])
        faces = torch.cat([faces[~beside], *halves])


def divide(faces: Int[Tensor, "F 3"], directions: Float[Tensor, "V 3"]) -> Bool[Tensor, " F"]:
    """Tell which faces of a closed mesh form a disk around +x; the others form one around -x.

    A face goes by the mean x of its corners' directions; then islands and places where the border would touch itself
    are given to the other side.
    """
    positive = directions[faces].sum(dim=1)[:, 0] >= 0
    edge_faces = topology_of(faces).edge_faces
    while True:
        positive = _largest_part(positive, edge_faces)
        positive = ~_largest_part(~positive, edge_faces)
        pinched = torch.bincount(border_edges(faces[positive]).flatten(), minlength=len(directions)) > 2
        if not pinched.any():
            return positive
        positive = positive | pinched[faces].any(dim=1)


def _largest_part(mask: Bool[Tensor, " F"], edge_faces: Int[Tensor, "E 2"]) -> Bool[Tensor, " F"]:
    """Keep the largest set of masked faces that hang together by edges."""
    first, second = edge_faces[mask[edge_faces].all(dim=1)].unbind(dim=1)
    labels, previous = torch.arange(len(mask)), torch.zeros(0)
    while not torch.equal(labels, previous):
        previous = labels
        labels = labels.scatter_reduce(0, first, previous[second], "amin")
        labels = labels.scatter_reduce(0, second, previous[first], "amin")
    return mask & (labels == labels[mask].mode().values)
