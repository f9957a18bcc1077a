import torch

from echoavatar.motion.kinematics.two_bone import REACH, reach


def legs(count=200, seed=0):
    """Thighs and shins of about 40 cm, bent by up to a right angle about x."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(count, 5, generator=generator).double()
    angle, zero = random[:, 0] * 1.5, torch.zeros(count).double()
    hip = torch.stack([zero, zero + 0.9, zero], -1)
    knee = hip + torch.stack([zero, zero - 0.41, zero], -1)
    ankle = knee + 0.4 * torch.stack([zero, -angle.cos(), -angle.sin()], -1)
    target = hip + (random[:, 1:4] - 0.5) * torch.tensor([0.4, 0.2, 0.4]) + torch.tensor([0.0, -0.6, 0.0])
    hinge = torch.tensor([1.0, 0, 0]).double().expand(count, 3)
    return hip, knee, ankle, hinge, target


def bent(hip, knee, ankle, first, second):
    middle = hip + (first @ (knee - hip)[..., None]).squeeze(-1)
    return middle, middle + (second @ (ankle - knee)[..., None]).squeeze(-1)


def test_targets_in_reach_are_met():
    hip, knee, ankle, hinge, target = legs()
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=target)
    torch.testing.assert_close(bent(hip, knee, ankle, first, second)[1], target, atol=1e-9, rtol=0)


def test_knees_bend_forward_only():
    """In the plane of the leg, the knee lies ahead (+z) of the line from hip to ankle."""
    hip, knee, ankle, hinge, target = legs()
    target = target * torch.tensor([0.0, 1.0, 0.0]) + hip * torch.tensor([1.0, 0.0, 1.0])
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=target)
    middle, _ = bent(hip, knee, ankle, first, second)
    assert float(middle[:, 2].min()) > 0


def test_out_of_reach_is_stretched_towards_it():
    hip, knee, ankle, hinge, _ = legs(3)
    target = hip + torch.tensor([0.0, -2.0, 0.5])
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=target)
    _, end = bent(hip, knee, ankle, first, second)
    torch.testing.assert_close((end - hip).norm(dim=-1), torch.full((3,), REACH * 0.81).double())
    cosine = torch.nn.functional.cosine_similarity(end - hip, target - hip)
    torch.testing.assert_close(cosine, torch.ones(3).double())


def test_where_the_ankle_is_already_nothing_turns():
    hip, knee, ankle, hinge, _ = legs()
    first, second = reach(hip=hip, knee=knee, ankle=ankle, hinge=hinge, target=ankle)
    bend = torch.linalg.vector_norm(first - torch.eye(3), dim=(-1, -2))
    is_clear = (ankle - knee)[:, 2].abs() > 0.05  # a straight leg is bent by what REACH leaves
    assert float(bend[is_clear].max()) < 1e-6
    assert float(torch.linalg.vector_norm(second - torch.eye(3), dim=(-1, -2))[is_clear].max()) < 1e-6
