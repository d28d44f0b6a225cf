"""Time a photograph's way to a textured mesh, as GLB and OBJ, with the model of laptop size loaded.

Goal on a CPU: half a second. The model has random weights, which do not change the time.
"""

from pathlib import Path

import torch
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.bench_training import trainer_of
from benchmarks.measuring import DEVICE, complete
from pipeline.export.glb import write_glb
from pipeline.export.obj import write_obj
from pipeline.export.seam import cut_open
from pipeline.networks.feature_extractor import extract
from pipeline.seeding import generator


@torch.no_grad()
def test_photograph_to_mesh(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    trainer = trainer_of("laptop")
    model = trainer.model.eval()
    seam = cut_open(model.faces.cpu(), model.directions.cpu())
    photograph = torch.rand(1, 3, 32, 32, generator=generator(0)).to(DEVICE)

    def reconstruct() -> None:
        features = [layer.float() for layer in extract(trainer.extractor, photograph, 1)]
        scene = model.infer(photograph, features)
        vertices, texture = scene.vertices[0].cpu(), scene.texture_maps[0].cpu()
        mesh = seam.unwrap(vertices, texture.shape[-1])
        write_glb(tmp_path / "object.glb", mesh, texture)
        write_obj(tmp_path / "object.obj", mesh, texture)

    benchmark.pedantic(complete(reconstruct), rounds=20, warmup_rounds=1)
