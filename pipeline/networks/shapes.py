"""Shapes of the full model: from a code to parameters, and from parameters to vertices (paper section 3.2.1)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from pipeline.errors import ConfigError, MeshError
from pipeline.geometry.compliance import compliance_matrix
from pipeline.geometry.ffd import CONTROL_POINTS, control_point_weights, deform
from pipeline.geometry.normalize import fit_unit_cube
from pipeline.geometry.symmetry import is_symmetric, mirror_index, symmetrize
from pipeline.geometry.thickness import FarSide, far_side, thickness
from pipeline.geometry.topology import laplacian_matrix
from pipeline.ranges import Fraction, NonNegative, Positive
from pipeline.rendering.lighting import vertex_normals
from pipeline.rendering.renderer import Mesh

SLOPE = 0.1
"""Of the shape decoder's rectifiers where they are negative: what pushes every unit down could silence plain ones for
ever (docs/decisions/shapes-and-hues.md)."""

FLAT = 0.002
"""What hardly counts as roughness, in world units."""


@dataclass(frozen=True)
class BaseLearningConfig:
    """How a base shape goes on learning in full training (ours)."""

    reach: NonNegative
    """Vertex offset at parameter 1 all over the shape, in world units."""
    stiffness: NonNegative
    """How far a step at one vertex carries its neighbours along, see `compliance_matrix`."""
    mirror: bool
    """Whether offsets are mirror-symmetric about x = 0, as the base shape then has to be."""
    thinnest: Fraction
    """Part of its first thickness that the shape may keep at no price; nothing else keeps its two sides apart."""


@dataclass(frozen=True)
class ShapeConfig:
    """How predicted shapes may differ from the base shape, and how that goes on learning."""

    mirror: bool
    """Whether predicted shapes are mirror-symmetric about x = 0."""
    grid_reach: NonNegative
    """Control point offset at parameter 1, in world units."""
    dimension_reach: NonNegative
    """Logarithm of a relative dimension at parameter 1."""
    base_learning: BaseLearningConfig | None
    """None keeps the base shape as it was learned, as in the paper."""
    offset_reach: Positive
    """Vertex offset at parameter 1 in single-stage training, in world units."""


class BaseOffsets(nn.Module):
    """Offsets of a base shape's vertices, which all photographs of a category share and teach together (ours)."""

    compliance: Float[Tensor, "V V"]
    laplacian: Float[Tensor, "V V"]
    mirrored_vertices: Int[Tensor, " V"] | None
    far_inwards: Float[Tensor, "V 3"]
    far_corners: Int[Tensor, "V 3"]
    far_weights: Float[Tensor, "V 3"]
    least_thickness: Float[Tensor, " V"]

    def __init__(self, base: Mesh, config: BaseLearningConfig) -> None:
        """Start without offsets. Raises ConfigError for a base shape that is less symmetric than its offsets."""
        super().__init__()
        self.parameters_by_vertex = nn.Parameter(torch.zeros_like(base.vertices[0]))
        compliance = config.reach * compliance_matrix(base.faces, config.stiffness)
        laplacian = laplacian_matrix(base.faces)
        self.register_buffer("compliance", compliance, persistent=False)
        self.register_buffer("laplacian", laplacian / laplacian.diagonal()[:, None], persistent=False)
        self.register_buffer("mirrored_vertices", _mirror_of(base) if config.mirror else None, persistent=False)
        far = far_side(base.vertices[0], base.faces, vertex_normals(base.vertices, base.faces)[0])
        for name, part in far._asdict().items():
            self.register_buffer(f"far_{name}", part, persistent=False)
        least = config.thinnest * thickness(base.vertices[0], far)
        self.register_buffer("least_thickness", least, persistent=False)

    def forward(self) -> Float[Tensor, "V 3"]:
        """Return the offsets in world units. Gradients flow to the parameters."""
        offsets = self.compliance @ self.parameters_by_vertex
        return offsets if self.mirrored_vertices is None else symmetrize(offsets, self.mirrored_vertices)

    def roughness(self) -> Float[Tensor, ""]:
        """Return the sum over vertices of the distance of an offset from the mean of its neighbours', in world units.

        Of offsets, not of the shape: what no photograph asks for, such as relief, stays as it was learned. Of
        distances, not of squared ones: an edge costs no more than a bend of the same angle, but bumps all over cost
        much. Below `FLAT` the distance grows with the square, so that the gradient has no step at 0.
        """
        squares = (self.laplacian @ self()).square().sum(dim=1)
        return ((squares + FLAT**2).sqrt() - FLAT).sum()

    def thinness(self, base: Float[Tensor, "V 3"]) -> Float[Tensor, ""]:
        """Return the sum over vertices of the squared thickness that the shape lacks to be as thick as it has to be.

        `base` is the shape with its offsets, in the unit cube.
        """
        far = FarSide(self.far_inwards, self.far_corners, self.far_weights)
        return (self.least_thickness - thickness(base, far)).clamp_min(0).square().sum()


def _mirror_of(base: Mesh) -> Int[Tensor, " V"]:
    # Of directions, which differ even where surfaces touch.
    try:
        mirror = mirror_index(base.directions)
    except MeshError:
        mirror = None
    if mirror is None or not is_symmetric(base.vertices[0], mirror):
        raise ConfigError(
            "the base shape is not mirror-symmetric, but train_full.model.shape.base_learning.mirror is true; set it "
            "to false, or learn the base shape with symmetry"
        )
    return mirror


class FreeFormShapes(nn.Module):
    """Deform a base shape by a 4x4x4 grid and by relative width, height and depth (paper section 3.2.1).

    Parameters are the 64 x 3 offsets of the control points in units of `grid_reach`, then the logarithms of the three
    relative dimensions in units of `dimension_reach`. A base shape that goes on learning takes its vertices' weights in
    the grid along.
    """

    base_vertices: Float[Tensor, "V 3"]
    weights: Float[Tensor, "V 64"]
    mirrored_points: Int[Tensor, " 64"]
    correlation_root: Float[Tensor, "64 64"]

    def __init__(self, base: Mesh, config: ShapeConfig) -> None:
        super().__init__()
        base_vertices, self.config = base.vertices[0], config
        self.base_offsets = None if config.base_learning is None else BaseOffsets(base, config.base_learning)
        self.parameter_count = CONTROL_POINTS * 3 + 3
        axis = torch.arange(4.0)
        grid = torch.cartesian_prod(axis, axis, axis) / 3 - 0.5
        self.register_buffer("base_vertices", base_vertices, persistent=False)
        self.register_buffer("weights", control_point_weights(base_vertices), persistent=False)
        self.register_buffer("mirrored_points", mirror_index(grid), persistent=False)
        correlation = (-torch.cdist(3 * grid, 3 * grid).square() / 2).exp()
        positive = correlation + 1e-4 * torch.eye(CONTROL_POINTS)  # in spite of rounding
        self.register_buffer("correlation_root", torch.linalg.cholesky(positive), persistent=False)

    def base(self) -> Float[Tensor, "V 3"]:
        """Return the base shape as it is now, in the unit cube. Gradients flow to its offsets, where it has any."""
        if self.base_offsets is None:
            return self.base_vertices
        return fit_unit_cube((self.base_vertices + self.base_offsets())[None])[0]

    def forward(self, parameters: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return the deformed vertices, scaled into the unit cube. Gradients flow to parameters and base shape."""
        return self._deform(self.base(), parameters)

    def around_fixed_base(self, parameters: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return the same vertices. Gradients flow to the parameters alone."""
        return self._deform(self.base().detach(), parameters)

    def _deform(self, base: Float[Tensor, "V 3"], parameters: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        offsets = self.config.grid_reach * parameters[:, :-3].unflatten(1, (CONTROL_POINTS, 3))
        if self.config.mirror:
            offsets = symmetrize(offsets, self.mirrored_points)
        dimensions = (self.config.dimension_reach * parameters[:, -3:]).exp()
        return fit_unit_cube(deform(base, self.weights, offsets) * dimensions[:, None])

    def draw(self, count: int, spread: float | Float[Tensor, "B 1"], rng: torch.Generator) -> Float[Tensor, "B K"]:
        """Draw parameters from a normal distribution around the base shape.

        Offsets of control points d steps of the grid apart are correlated by exp(-d^2/2): independent ones cancel each
        other, so that the shape hardly changes and nobody can see from a picture what was drawn.
        """
        normal = torch.randn(count, self.parameter_count, generator=rng, device=rng.device)
        offsets = self.correlation_root @ normal[:, :-3].unflatten(1, (CONTROL_POINTS, 3))
        return spread * torch.cat([offsets.flatten(1), normal[:, -3:]], 1)


class OffsetShapes(nn.Module):
    """Deform an ellipsoid by one offset a vertex: the shapes of single-stage training (paper sections 3.1.1 and 4.1.3).

    Parameters are offsets in units of `reach`; random ones are uniform over the surface, because independent offsets of
    neighbouring vertices would only make it rough.
    """

    base_vertices: Float[Tensor, "V 3"]
    mirrored_vertices: Int[Tensor, " V"]

    def __init__(self, base: Mesh, config: ShapeConfig) -> None:
        super().__init__()
        base_vertices, self.reach, self.mirror = base.vertices[0], config.offset_reach, config.mirror
        self.parameter_count = base_vertices.numel()
        self.register_buffer("base_vertices", base_vertices, persistent=False)
        self.register_buffer("mirrored_vertices", mirror_index(base_vertices), persistent=False)

    def forward(self, parameters: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return the deformed vertices, scaled into the unit cube. Gradients flow to the parameters."""
        offsets = self.reach * parameters.unflatten(1, (-1, 3))
        if self.mirror:
            offsets = symmetrize(offsets, self.mirrored_vertices)
        return fit_unit_cube(self.base_vertices + offsets)

    def base(self) -> Float[Tensor, "V 3"]:
        """Return the ellipsoid."""
        return self.base_vertices

    def around_fixed_base(self, parameters: Float[Tensor, "B K"]) -> Float[Tensor, "B V 3"]:
        """Return the same vertices: an ellipsoid does not learn."""
        return self(parameters)

    def draw(self, count: int, spread: float | Float[Tensor, "B 1"], rng: torch.Generator) -> Float[Tensor, "B K"]:
        """Draw parameters that stretch the ellipsoid along the three axes by factors whose logarithms are normal.

        A factor below zero would turn it inside out.
        """
        factors = (spread * torch.randn(count, 3, generator=rng, device=rng.device)).exp()
        return ((factors[:, None] - 1) * self.base_vertices / self.reach).flatten(1)


class ShapeDecoder(nn.Module):
    """Regress the parameters of a shape space; starts at the base shape."""

    def __init__(self, code_size: int, hidden_size: int, parameter_count: int) -> None:
        super().__init__()
        output = nn.Linear(hidden_size, parameter_count)
        nn.init.normal_(output.weight, std=1e-3)
        nn.init.zeros_(output.bias)
        self.layers = nn.Sequential(nn.LeakyReLU(SLOPE), nn.Linear(code_size, hidden_size), nn.LeakyReLU(SLOPE), output)

    def forward(self, code: Float[Tensor, "B K"]) -> Float[Tensor, "B parameters"]:
        """Return shape parameters."""
        return self.layers(code)
