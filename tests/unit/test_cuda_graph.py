"""Steps as CUDA graphs: as they are on a CPU, the same results from a graph on a GPU."""

import pytest
import torch
from torch import Tensor, nn

from pipeline.seeding import generator, initialised
from pipeline.training.cuda_graph import GraphedStep
from pipeline.training.optimization import adam, set_learning_rate, take_step


def test_on_a_cpu_every_step_is_taken() -> None:
    taken: list[Tensor] = []

    def step(value: Tensor) -> dict[str, Tensor]:
        taken.append(value)
        return {"loss": 2 * value}

    graphed = GraphedStep(step, torch.device("cpu"))
    losses = [graphed(torch.tensor(float(number)))["loss"].item() for number in range(6)]
    assert losses == [0, 2, 4, 6, 8, 10]
    assert len(taken) == 6


@pytest.mark.gpu
def test_a_graph_trains_as_the_steps_themselves_do() -> None:
    device = torch.device("cuda")
    batches = torch.randn(12, 16, 4, generator=generator(0)).to(device)
    weights = []
    for device_of_graph in (torch.device("cpu"), device):  # which a step on a GPU is never captured for, and is
        with initialised(0):
            network = nn.Sequential(nn.Linear(4, 8), nn.ReLU(), nn.Linear(8, 1)).to(device)
        optimizer = adam(network.parameters(), 0.1, (0.9, 0.99))
        losses: list[Tensor] = []

        def step(batch: Tensor, network: nn.Module = network, optimizer: torch.optim.Adam = optimizer) -> dict:
            loss = (network(batch) - batch.sum(dim=1, keepdim=True)).square().mean()
            take_step(loss, optimizer)
            return {"loss": loss.detach()}

        graphed = GraphedStep(step, device_of_graph)
        for number, batch in enumerate(batches):
            set_learning_rate(0.1 / (1 + number), optimizer)
            losses.append(graphed(batch)["loss"])
        weights.append(torch.cat([torch.stack(losses), *(p.detach().flatten() for p in network.parameters())]))
    torch.testing.assert_close(weights[0], weights[1], rtol=1e-4, atol=1e-5)


@pytest.mark.gpu
def test_a_graph_draws_new_numbers_each_time() -> None:
    rng = generator(0, device=torch.device("cuda"))
    graphed = GraphedStep(lambda: {"drawn": torch.rand((), generator=rng, device="cuda")}, rng.device, rng)
    drawn = [graphed()["drawn"].item() for _ in range(10)]
    assert len(set(drawn)) == 10
