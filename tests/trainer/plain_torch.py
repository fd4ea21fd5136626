"""The arithmetic of a frontier, one group after the other, differentiated by torch: an oracle."""

import torch

from reference_trainer.models.adam import GROUPS
from reference_trainer.models.blocks import LEARNED, Collinear, Free
from reference_trainer.models.tensors import SplatTensors


def evolve_plain(base, blocks, live):
    """What `blocks.evolve` and `Evolution` make."""
    rows, out = torch.from_numpy(live), []
    for group, constants in enumerate(base):
        values = constants.reshape(len(constants), -1)
        for block in blocks:
            values = _evolved(block, group, values)
        out.append(values[rows].reshape(len(live), *constants.shape[1:]))
    return SplatTensors(*out)


def _evolved(block, group, values):
    slots = torch.from_numpy(block.slots)
    parents = values[slots]
    if isinstance(block, Collinear):
        psi = _rows(block.psi[group])
        learns = GROUPS[group] in LEARNED[block.kind]
        alpha = block.alpha.value if learns else block.alpha.value.detach()
        first, second = parents + psi, [parents - alpha[:, group, None] * psi]
    elif isinstance(block, Free):
        parents = float(block.keep) * parents
        first = parents + _rows(block.variables[group])
        second = [parents + _rows(block.variables[5 + group])]
    else:
        first, second = parents + _rows(block.variables[group]), []
    return torch.cat([values.index_copy(0, slots, first), *second])


def _rows(variable):
    return variable.value.reshape(len(variable.value), -1)
