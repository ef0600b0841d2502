"""A gate network as the actor of Stable-Baselines3's algorithms, with a critic beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs
from torch import nn
from torch.distributions import Normal

from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES
from ptne_env.learn.training.network import GateNetwork

_OWN = ("flow", "step", "response", "push", "dither")
_OTHERS = ("copies", "track", "belief", "stated", "copy", "mean")
"""Gates that own components follow, and those that components of others follow; both follow the rest."""

_TURN = CELL_FEATURES.index("turn")


class GatePolicy(ActorCriticPolicy):
    """Actor and critic on observations of :class:`~ptne_env.learn.training.cells.CellVecEnv`.

    Gates that have no effect, such as the dither of a component of another player or the share of a dead link in the
    copy, do not count in the probability of an action.

    Attributes:
        actor: answers the gates.
        kept: the best network so far, which training may return to.

    Args:
        *arguments: of Stable-Baselines3's class.
        network: arguments of :class:`~ptne_env.learn.training.network.GateNetwork`.
        **named: of Stable-Baselines3's class; ``log_std_init`` is that of every gate.
    """

    def __init__(self, *arguments: Any, network: dict[str, Any] | None = None, **named: Any) -> None:
        self._network_arguments = network or {}
        super().__init__(*arguments, **named)

    def _build(self, lr_schedule: Any) -> None:
        cell, slot = len(CELL_FEATURES), len(SLOT_FEATURES)
        self.actor = GateNetwork(**self._network_arguments)
        self.kept = GateNetwork(**self._network_arguments).requires_grad_(requires_grad=False)
        self.critic = nn.Sequential(
            nn.Linear(cell + 2 * slot, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1)
        )
        self.log_std = nn.Parameter(torch.full((len(CellGates._fields) + len(SlotGates._fields),), self.log_std_init))
        self.optimizer = self.optimizer_class(self.parameters(), **{"lr": lr_schedule(1), **self.optimizer_kwargs})

    def _split(self, observations: PyTorchObs) -> tuple[torch.Tensor, torch.Tensor]:
        assert isinstance(observations, torch.Tensor)  # noqa: S101 - the other kinds are of other spaces
        cell, slot = observations.split([len(CELL_FEATURES), observations.shape[1] - len(CELL_FEATURES)], dim=1)
        return cell, slot.unflatten(1, (-1, len(SLOT_FEATURES)))

    def _value(self, cell: torch.Tensor, slot: torch.Tensor) -> torch.Tensor:
        live = slot[:, :, SLOT_FEATURES.index("live"), None]
        heard = slot * live
        mean = heard.sum(dim=1) / live.sum(dim=1).clamp(min=1.0)
        return self.critic(torch.cat([cell, mean, heard.amax(dim=1)], dim=1))

    def _distribution(self, cell: torch.Tensor, slot: torch.Tensor) -> tuple[Normal, torch.Tensor]:
        """Of actions, and whether each of them has an effect, both (C, action size)."""
        mine, theirs = self.actor(cell, slot)
        std = self.log_std.exp()
        per_cell, per_slot = std.split([mine.shape[1], theirs.shape[2]])
        spread = torch.cat([per_cell, per_slot.repeat(slot.shape[1])])
        return Normal(torch.cat([mine, theirs.flatten(1)], dim=1), spread, validate_args=False), effects(cell, slot)

    def forward(
        self,
        obs: torch.Tensor,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Actions (C, action size), values (C, 1) and logarithms of probabilities (C,)."""
        cell, slot = self._split(obs)
        distribution, acts = self._distribution(cell, slot)
        actions = distribution.mean if deterministic else distribution.sample()
        return actions, self._value(cell, slot), (distribution.log_prob(actions) * acts).sum(dim=1)

    def evaluate_actions(
        self, obs: PyTorchObs, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Values, logarithms of probabilities, and entropies of given actions."""
        cell, slot = self._split(obs)
        distribution, acts = self._distribution(cell, slot)
        log_prob = (distribution.log_prob(actions) * acts).sum(dim=1)
        return self._value(cell, slot), log_prob, (distribution.entropy() * acts).sum(dim=1)

    def predict_values(self, obs: PyTorchObs) -> torch.Tensor:
        """Values, shape (C, 1)."""
        return self._value(*self._split(obs))

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:  # noqa: FBT001, FBT002
        distribution, _ = self._distribution(*self._split(observation))
        return distribution.mean if deterministic else distribution.sample()


def effects(cell: torch.Tensor, slot: torch.Tensor) -> torch.Tensor:
    """Whether each gate has an effect, from features (C, F) and (C, D, S): 0 or 1, shape (C, 10 + 3 D).

    Messages over dead links are not read, but the private belief keeps their means. A belief without any samples is the
    copy, and a component that waits for its turn has no response.
    """
    own = cell[:, CELL_FEATURES.index("own"), None]
    live, sampled = ((slot[:, :, SLOT_FEATURES.index(name), None] > 0).float() for name in ("live", "samples"))
    per_cell = {**dict.fromkeys(("belief", "stated"), sampled.amax(dim=1)), "response": cell[:, [_TURN]]}
    mine = _effect(CellGates._fields, own) * _joined(CellGates._fields, per_cell, torch.ones_like(own))
    per_slot = _joined(SlotGates._fields, {"mean": sampled}, live)
    return torch.cat([mine, (_effect(SlotGates._fields, own)[:, None] * per_slot).flatten(1)], dim=1)


def _joined(gates: tuple[str, ...], conditions: Mapping[str, torch.Tensor], otherwise: torch.Tensor) -> torch.Tensor:
    """The condition of each gate side by side, in the last dimension."""
    return torch.cat([conditions.get(name, otherwise) for name in gates], dim=-1)


def _effect(gates: tuple[str, ...], own: torch.Tensor) -> torch.Tensor:
    """Whether each gate of a cell has an effect, shape (C, gates), from the flag ``own``, (C, 1)."""
    mine = torch.tensor([0.0 if name in _OTHERS else 1.0 for name in gates])
    others = torch.tensor([0.0 if name in _OWN else 1.0 for name in gates])
    return own * mine + (1.0 - own) * others
