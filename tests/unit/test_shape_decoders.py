"""Shapes of the full model."""

import math
from dataclasses import replace

import pytest
import torch

from pipeline.errors import ConfigError
from pipeline.geometry.symmetry import mirror_index, reflect
from pipeline.networks.shapes import FreeFormShapes, OffsetShapes, ShapeDecoder
from pipeline.seeding import generator, initialised
from tests.tiny_full_model import MODEL, base_mesh

BASE = base_mesh().vertices[0]
CONFIG = replace(MODEL.shape, dimension_reach=0.5)


def free_form(mirror: bool) -> FreeFormShapes:
    return FreeFormShapes(base_mesh(), replace(CONFIG, mirror=mirror))


def offset(mirror: bool) -> OffsetShapes:
    return OffsetShapes(base_mesh(), replace(CONFIG, mirror=mirror))


def test_zero_parameters_are_the_base_shape() -> None:
    for shapes in (free_form(mirror=True), offset(mirror=True)):
        vertices = shapes(torch.zeros(2, shapes.parameter_count))
        torch.testing.assert_close(vertices, BASE.expand(2, -1, -1), atol=1e-6, rtol=0)


def test_a_step_of_the_base_shape_is_smooth_symmetric_and_shared() -> None:
    shapes, mirror = free_form(mirror=True), mirror_index(BASE)
    assert shapes.base_offsets is not None
    parameters = shapes.draw(3, 0.3, generator(0))
    before, vertex = shapes(parameters), int(BASE[:, 0].argmax())
    with torch.no_grad():
        shapes.base_offsets.parameters_by_vertex[vertex, 1] = 0.1
    moved = shapes.base() - BASE
    torch.testing.assert_close(reflect(moved)[mirror], moved, atol=1e-6, rtol=0)
    near, far = (BASE - BASE[vertex]).norm(dim=1).argsort()[[1, -1]]
    assert moved[vertex, 1] > moved[near, 1] > 0.2 * moved[vertex, 1]
    assert (shapes(parameters) - before)[:, vertex, 1].min() > 10 * (shapes(parameters) - before)[:, far].abs().max()


def test_an_asymmetric_base_shape_learns_without_mirroring_alone() -> None:
    mesh = base_mesh()
    slanted = mesh.directions + 0.1 * mesh.directions[:, [1, 0, 2]]
    asymmetric = mesh._replace(directions=slanted)
    for other in (asymmetric, mesh._replace(vertices=mesh.vertices + 0.1 * mesh.vertices[..., [1, 0, 2]])):
        with pytest.raises(ConfigError, match=r"base_learning\.mirror"):
            FreeFormShapes(other, CONFIG)
    assert CONFIG.base_learning is not None
    unmirrored = replace(CONFIG.base_learning, mirror=False)
    shapes = FreeFormShapes(asymmetric, replace(CONFIG, base_learning=unmirrored))
    assert shapes.base_offsets is not None
    with torch.no_grad():
        shapes.base_offsets.parameters_by_vertex[int(BASE[:, 0].argmax()), 1] = 0.1
    moved = shapes.base() - BASE
    assert (reflect(moved)[mirror_index(BASE)] - moved).abs().max() > 0.01


def test_surfaces_that_touch_can_learn() -> None:
    mesh = base_mesh()
    on_plane = (mesh.directions[:, 0].abs() < 1e-6).nonzero().flatten()
    vertices = mesh.vertices.clone()
    vertices[0, on_plane[0]] = vertices[0, on_plane[1]]
    shapes = FreeFormShapes(mesh._replace(vertices=vertices), CONFIG)
    torch.testing.assert_close(shapes.base(), vertices[0])


def test_offsets_are_rough_where_they_differ_from_their_neighbours() -> None:
    offsets, faces = free_form(mirror=True).base_offsets, base_mesh().faces
    assert offsets is not None
    with torch.no_grad():
        offsets.parameters_by_vertex[:, 1] = 0.1  # all are moved alike
    assert offsets.roughness() < 1e-9
    with torch.no_grad():
        offsets.parameters_by_vertex[5, 2] = 0.1
    moved, expected = offsets().detach(), 0.0
    for vertex in range(len(moved)):
        neighbours = faces[(faces == vertex).any(dim=1)].unique()
        distance = float((moved[vertex] - moved[neighbours[neighbours != vertex]].mean(dim=0)).norm())
        expected += math.hypot(distance, 0.002) - 0.002
    assert offsets.roughness().item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("size", "growth"), [(1e-4, 4.0), (1.0, 2.0)])
def test_roughness_grows_with_the_square_of_dents_alone_that_hardly_count(size: float, growth: float) -> None:
    offsets = free_form(mirror=True).base_offsets
    assert offsets is not None
    roughness = []
    for dent in (size, 2 * size):
        with torch.no_grad():
            offsets.parameters_by_vertex[5, 2] = dent
        roughness.append(offsets.roughness().item())
    assert roughness[1] == pytest.approx(growth * roughness[0], rel=0.1)


def test_a_base_shape_pays_for_what_is_thinner_than_part_of_what_it_was() -> None:
    assert CONFIG.base_learning is not None
    halved = replace(CONFIG.base_learning, thinnest=0.5)
    offsets = FreeFormShapes(base_mesh(), replace(CONFIG, base_learning=halved)).base_offsets
    assert offsets is not None
    assert offsets.thinness(BASE) == offsets.thinness(0.51 * BASE) == 0
    thin, inside_out = offsets.thinness(0.4 * BASE), offsets.thinness(-0.4 * BASE)
    assert thin > 0
    assert inside_out.item() == pytest.approx(81 * thin.item(), rel=1e-4)  # .9 of the thickness is lacking, not .1


def test_a_base_shape_stays_in_the_unit_cube() -> None:
    shapes = free_form(mirror=True)
    assert shapes.base_offsets is not None
    with torch.no_grad():
        shapes.base_offsets.parameters_by_vertex.copy_(-0.1 * BASE)  # shrink
    torch.testing.assert_close((shapes.base().amax(0) - shapes.base().amin(0)).amax(), torch.tensor(1.0))


def test_without_learning_the_base_shape_has_nothing_to_learn() -> None:
    shapes = FreeFormShapes(base_mesh(), replace(CONFIG, base_learning=None))
    assert not list(shapes.parameters())
    assert torch.equal(shapes.base(), BASE)


def test_last_parameters_are_relative_dimensions() -> None:
    shapes = free_form(mirror=True)
    parameters = torch.zeros(1, shapes.parameter_count)
    parameters[0, -3] = 1
    before, after = (v.amax(0) - v.amin(0) for v in (BASE, shapes(parameters)[0]))
    torch.testing.assert_close((after / after[2]) / (before / before[2]), torch.tensor([math.exp(0.5), 1.0, 1.0]))


def test_one_control_point_moves_its_own_corner_most() -> None:
    shapes = free_form(mirror=False)
    parameters = torch.zeros(1, shapes.parameter_count)
    parameters[0, 3 * 63 : 3 * 64] = 1  # the corner at (+, +, +)
    moved = shapes(parameters)[0] - BASE
    distances = (BASE - 0.5).norm(dim=1)
    assert moved[distances.argmin()].norm() > 3 * moved[distances.argmax()].norm()


def test_mirrored_shapes_are_symmetric_and_fit_the_unit_cube() -> None:
    mirror = mirror_index(BASE)
    for shapes in (free_form(mirror=True), offset(mirror=True)):
        vertices = shapes(torch.randn(4, shapes.parameter_count, generator=generator(0)))
        torch.testing.assert_close(reflect(vertices)[:, mirror], vertices, atol=1e-6, rtol=0)
        torch.testing.assert_close((vertices.amax(1) - vertices.amin(1)).amax(1), torch.ones(4))


def test_without_mirroring_shapes_are_not_symmetric() -> None:
    mirror = mirror_index(BASE)
    for shapes in (free_form(mirror=False), offset(mirror=False)):
        vertices = shapes(torch.randn(4, shapes.parameter_count, generator=generator(0)))
        assert (reflect(vertices)[:, mirror] - vertices).abs().amax() > 0.02


def test_random_ellipsoids_are_smooth() -> None:
    shapes = offset(mirror=True)
    vertices = shapes(shapes.draw(1, 0.3, generator(0)))[0]
    stretch = (vertices.amax(0) - vertices.amin(0)) / (BASE.amax(0) - BASE.amin(0))
    middle = (vertices.amax(0) + vertices.amin(0)) / 2 - stretch * (BASE.amax(0) + BASE.amin(0)) / 2
    torch.testing.assert_close(vertices, BASE * stretch + middle, atol=1e-5, rtol=0)
    assert (stretch / stretch[2] - 1).abs().amax() > 0.02


def test_random_ellipsoids_are_never_inside_out() -> None:
    shapes, (faces,) = offset(mirror=True), (base_mesh().faces,)
    spreads = torch.full((500, 1), 0.5).index_fill(0, torch.arange(250), 0.01)
    corners = shapes(shapes.draw(500, spreads, generator(0)))[:, faces].unbind(dim=2)
    volumes = (corners[0] * torch.linalg.cross(corners[1], corners[2])).sum(dim=(1, 2)) / 6
    assert volumes.min() > 0
    assert volumes[250:].std() > 10 * volumes[:250].std()


def test_random_grids_move_neighbours_alike() -> None:
    shapes = free_form(mirror=False)
    parameters = shapes.draw(2000, 0.5, generator(0))
    torch.testing.assert_close(parameters.std(dim=0), torch.full((195,), 0.5), atol=0.05, rtol=0)
    offsets = parameters[:, :-3].unflatten(1, (4, 4, 4, 3))
    near, far = (
        torch.corrcoef(torch.stack([offsets[:, 0, 0, 0, 0], offsets[:, 0, 0, k, 0]]))[0, 1].item() for k in (1, 3)
    )
    assert abs(near - math.exp(-0.5)) < 0.06
    assert abs(far) < 0.06


def test_decoder_stays_alive_where_it_is_pushed_to_the_base_shape() -> None:
    with initialised(0):
        decoder = ShapeDecoder(8, 16, 195)
    optimizer = torch.optim.Adam(decoder.parameters(), lr=3e-3)
    codes = torch.randn(64, 8, generator=generator(0))
    noise = torch.randn(200, 64, 195, generator=generator(1))
    for wanted in noise:
        optimizer.zero_grad()
        (decoder(codes) - wanted).abs().mean().backward()
        optimizer.step()
    wanted = codes[:, :1].expand(-1, 195)
    for _ in range(200):
        optimizer.zero_grad()
        (decoder(codes) - wanted).abs().mean().backward()
        optimizer.step()
    assert (decoder(codes) - wanted).abs().mean() < 0.3 * wanted.abs().mean()


def test_decoder_starts_near_the_base_shape() -> None:
    with initialised(0):
        decoder = ShapeDecoder(8, 16, 195)
    parameters = decoder(torch.randn(4, 8, generator=generator(0)))
    assert 0 < parameters.abs().amax() < 0.02


def test_units_that_are_all_pushed_down_still_pass_gradients() -> None:
    with initialised(0):
        decoder = ShapeDecoder(8, 16, 195)
    for layer in decoder.modules():
        if isinstance(layer, torch.nn.Linear):
            torch.nn.init.constant_(layer.bias, -100.0)
    code = torch.full((1, 8), -1.0, requires_grad=True)
    decoder(code).sum().backward()
    assert code.grad is not None
    assert code.grad.all()
