"""Coordinates in which steps are smooth."""

import torch

from pipeline.geometry.compliance import compliance_matrix
from pipeline.geometry.icosphere import icosphere
from pipeline.geometry.topology import topology_of

DIRECTIONS, FACES = icosphere(2)


def test_a_shift_stays_a_shift_and_a_spike_becomes_a_bump() -> None:
    compliance = compliance_matrix(FACES, 5.0)
    torch.testing.assert_close(compliance.sum(dim=1), torch.ones(len(DIRECTIONS)))
    bump = compliance[:, 0]
    start, end = topology_of(FACES).edges.unbind(dim=1)
    neighbours = torch.cat([end[start == 0], start[end == 0]])
    assert (bump[neighbours] > 0.3 * bump[0]).all()
    assert bump[(DIRECTIONS @ DIRECTIONS[0]).argmin()] < 0.05 * bump[0]


def test_without_stiffness_nothing_changes() -> None:
    torch.testing.assert_close(compliance_matrix(FACES, 0.0), torch.eye(len(DIRECTIONS)))
