import torch
from torch import nn

from echoavatar.training import TrainingConfig, adamw


def test_matrices_decay_and_the_rest_does_not_unless_asked():
    model, config = nn.Sequential(nn.Linear(2, 3), nn.LayerNorm(3)), TrainingConfig(weight_decay=0.2)
    model[1].bias.requires_grad_(False)
    groups = adamw([model], config).param_groups
    assert [(len(group["params"]), group["weight_decay"]) for group in groups] == [(1, 0.2), (2, 0.0)]
    groups = adamw([model], config, decays_vectors=True, but=[model[0].weight]).param_groups
    assert [(len(group["params"]), group["weight_decay"]) for group in groups] == [(2, 0.2)]
    assert groups[0]["betas"] == config.betas
    assert isinstance(adamw([model], config), torch.optim.AdamW)
