"""A person's body on our bones, in the modelled pose: what all visible parts are cut from or placed by."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from . import fit
from .base import face_unit, load_base
from .person import Person


@dataclass(frozen=True)
class Eye:
    """An eyeball."""

    middle: Float[np.ndarray, " 3"]
    radius: float


@dataclass(frozen=True)
class Body:
    """All vertices of the base mesh on our bones, with their weights."""

    person: Person
    fitted: fit.Fit
    points: Float[np.ndarray, "v 3"]
    weights: Float[np.ndarray, "v j"]

    def move(self, curve: str) -> Float[np.ndarray, "v 3"]:
        """What a face curve at 1 moves; what the resting face has of it is done already."""
        return self._linear(face_unit(curve)) * (1 - self.person.rest.get(curve, 0.0))

    def _linear(self, moves: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        moved = np.abs(moves).max(1) > 0
        out = np.zeros_like(moves)
        out[moved] = np.einsum("vj,jik,vk->vi", self.weights[moved], self.fitted.posed[:, :, :3], moves[moved])
        return out

    @cached_property
    def eyes(self) -> dict[str, Eye]:
        """Both eyeballs by side, as large as the helper spheres of the base mesh."""
        made = {}
        for side, group in (("Left", "helper-l-eye"), ("Right", "helper-r-eye")):
            ball = self.points[load_base().vertices_of(group)]
            low, high = ball.min(0), ball.max(0)
            radius = float((high - low)[:2].mean() / 2)
            middle = (low + high) / 2
            made[side] = Eye(middle, radius)
        return made

    def middle(self, group: str) -> Float[np.ndarray, " 3"]:
        """The middle of a group of the base mesh, such as one of its joint cubes."""
        return np.asarray(self.points[load_base().vertices_of(group)].mean(0))

    def joint(self, name: str) -> Float[np.ndarray, " 3"]:
        """A joint of the rig in the modelled pose."""
        j = fit.NAMES.index(name)
        return np.asarray(self.fitted.pose[j, :, :3] @ fit.REST[j] + self.fitted.pose[j, :, 3])

    def one(self, name: str, count: int) -> Float[np.ndarray, "n j"]:
        """Weights of points that follow one joint."""
        table = np.zeros((count, len(fit.NAMES)))
        table[:, fit.NAMES.index(name)] = 1
        return table


def make_body(person: Person) -> Body:
    """The person's shape on our bones."""
    shape = person.shape()
    fitted, weights = fit.fit(shape), fit.weights_matrix()
    return Body(person, fitted, fit.posed(fitted, shape, weights), weights)
