import argparse

import pytest

from echoavatar.errors import EchoAvatarError
from echoavatar.motion.kinematics import HUMANOID
from echoavatar_lab.commands.recipe import Options
from echoavatar_lab.commands.train_tokenizer import add_arguments, body_sizes


def settings(model: dict[str, object]):
    parser = argparse.ArgumentParser()
    options = Options(parser)
    add_arguments(parser, options)
    return options.settings(parser.parse_args([]), {"model": {"width": 32, "heads": 2, "lookback": 15} | model})


def test_a_part_can_override_common_sizes() -> None:
    found = body_sizes(settings({"parts": {"hands": {"lookback": 7}}}), HUMANOID).parts
    assert {name: part.lookback for name, part in found.items()} == {"lower": 15, "upper": 15, "hands": 7}
    assert {part.width for part in found.values()} == {32}


def test_unknown_parts_and_unshared_widths_are_refused() -> None:
    with pytest.raises(EchoAvatarError, match="model.parts.tail is no part of the body; there are lower"):
        body_sizes(settings({"parts": {"tail": {}}}), HUMANOID)
    with pytest.raises(EchoAvatarError, match="may not differ in width"):
        body_sizes(settings({"parts": {"hands": {"width": 16}}}), HUMANOID)


def test_a_body_may_be_one_part() -> None:
    found = body_sizes(settings({"is_whole": True, "blocks": "convolution"}), HUMANOID)
    assert {name: (part.features, part.blocks) for name, part in found.parts.items()} == {"body": (315, "convolution")}
