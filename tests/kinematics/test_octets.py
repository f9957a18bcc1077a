"""The compiled arithmetic of the live path against the torch one."""

import numpy as np
import torch

from echoavatar.kinematics import octets
from echoavatar.kinematics import rotations as torch_side
from echoavatar.nn.octet import LANES, blocks, exact, load, store


@exact()
def _worked_out(given, made):  # type: ignore[no-untyped-def]
    """Of quaternions a and b and a vector v (11 numbers): products, matrices and vectors one below the other."""
    for block in range(len(given)):
        a = load(given, (block, 0)), load(given, (block, 1)), load(given, (block, 2)), load(given, (block, 3))
        b = load(given, (block, 4)), load(given, (block, 5)), load(given, (block, 6)), load(given, (block, 7))
        v = load(given, (block, 8)), load(given, (block, 9)), load(given, (block, 10))
        m, n = octets.matrix(a), octets.matrix(b)
        for k in range(4):
            store(made, (block, k), octets.multiply(a, b)[k])
            store(made, (block, 4 + k), octets.multiply(octets.conjugate(a), a)[k])
            store(made, (block, 8 + k), octets.quaternion(m)[k])
        for k in range(9):
            store(made, (block, 12 + k), m[k])
            store(made, (block, 21 + k), octets.composed(m, n)[k])
            store(made, (block, 30 + k), octets.seen_from(m, n)[k])
        for k in range(3):
            store(made, (block, 39 + k), octets.turned(m, v)[k])
            store(made, (block, 42 + k), octets.turned_back(m, v)[k])
            store(made, (block, 45 + k), octets.cross(octets.turned(m, v), v)[k])
            store(
                made, (block, 48 + k), octets.minus(octets.plus(v, octets.times(v, octets.dot(v, v))), v)[k]
            )


@exact()
def _from_rows(given, made):  # type: ignore[no-untyped-def]
    for block in range(len(given)):
        first = load(given, (block, 0)), load(given, (block, 1)), load(given, (block, 2))
        second = load(given, (block, 3)), load(given, (block, 4)), load(given, (block, 5))
        for k, number in enumerate(octets.from_two_rows(first, second)):
            store(made, (block, k), number)


def drawn(count: int, seed: int) -> np.ndarray:
    q = np.random.default_rng(seed).standard_normal((4, count)).astype(np.float32)
    return q / np.linalg.norm(q, axis=0)


def worked_out(a: np.ndarray, b: np.ndarray, v: np.ndarray) -> torch.Tensor:
    given = blocks(np.concatenate([a, b, v]))
    made = np.empty((len(given), 51, LANES), np.float32)
    _worked_out(given, made)
    return torch.from_numpy(made).permute(0, 2, 1).flatten(0, 1)[: a.shape[1]]


def test_everything_agrees_with_torch() -> None:
    a, b, v = drawn(203, 0), drawn(203, 1), drawn(203, 2)[:3]
    found = worked_out(a, b, v)
    p, q, w = (torch.from_numpy(x.T.copy()) for x in (a, b, v))
    m, n = torch_side.matrix_from_quaternion(p), torch_side.matrix_from_quaternion(q)
    turned = (m @ w[..., None])[..., 0]
    wanted = [
        torch_side.quaternion_multiply(p, q),
        torch.tensor([1.0, 0, 0, 0]).expand(203, 4),
        p,
        m.flatten(1),
        (m @ n).flatten(1),
        (m.mT @ n).flatten(1),
        turned,
        (m.mT @ w[..., None])[..., 0],
        torch.linalg.cross(turned, w),
        w * (w * w).sum(-1, keepdim=True),
    ]
    sign = (found[:, 8:12] * p).sum(-1, keepdim=True).sign()
    found[:, 8:12] *= sign  # of either sign
    torch.testing.assert_close(found, torch.cat(wanted, 1), atol=2e-6, rtol=0)


def test_half_turns_come_back() -> None:
    """Where w is 0 the other numbers serve."""
    q = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0]], np.float32).T
    found = worked_out(q, q, q[:3])[:, 8:12].numpy()
    np.testing.assert_allclose(np.abs(found), np.abs(q.T), atol=1e-6)


def from_rows(rows: np.ndarray) -> np.ndarray:
    given = blocks(rows)
    made = np.empty((len(given), 4, LANES), np.float32)
    _from_rows(given, made)
    return made.transpose(0, 2, 1).reshape(-1, 4)[: rows.shape[1]]


def test_two_rows_of_any_length_give_the_rotation() -> None:
    q = drawn(200, 3)
    rows = torch_side.matrix_from_quaternion(torch.from_numpy(q.T.copy()))[:, :2].numpy().copy()
    rows[:, 0] *= 3
    rows[:, 1] += 0.5 * rows[:, 0]  # neither unit nor at right angles
    np.testing.assert_allclose(np.abs((from_rows(rows.reshape(200, 6).T) * q.T).sum(-1)), 1, atol=1e-5)


def test_parallel_rows_and_garbage_give_no_rotation() -> None:
    rows = np.ones((6, 4), np.float32)
    rows[3:, 1], rows[0, 2], rows[4, 3] = 2.0, np.nan, np.inf
    assert not (np.square(from_rows(rows)).sum(-1) > 0.5).any()
