import pytest
import torch

from echoavatar_lab.data.feature_statistics import measure_features


def test_statistics_over_pieces_are_those_of_the_whole():
    generator = torch.Generator().manual_seed(3)
    features = torch.randn(100, 6, generator=generator) * 5 + 3
    features[:, 2] = 7.0
    found = measure_features([features[:10], features[10:11], features[11:]])
    torch.testing.assert_close(found.mean, features.mean(0))
    torch.testing.assert_close(found.std, features.std(0, correction=0), atol=1e-5, rtol=1e-5)
    assert found.varies.tolist() == [True, True, False, True, True, True]


def test_constant_features_do_not_blow_up():
    generator = torch.Generator().manual_seed(4)
    features = torch.randn(50, 3, generator=generator)
    features[:, 1] = 0.5
    found = measure_features([features])
    noisy = features + torch.tensor([0.0, 1e-3, 0.0])
    assert found.normalize(noisy)[:, 1].abs().max() == 0
    torch.testing.assert_close(found.denormalize(found.normalize(noisy)), features)


def test_nothing_to_measure_is_said():
    with pytest.raises(ValueError, match="no clip"):
        measure_features([])
