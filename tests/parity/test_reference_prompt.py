"""The prompt of the release, id by id, and what is drawn after it, against a generator that reads everything anew."""

import json

import pytest
import torch
from tests import golden as fixtures
from tests.models.generator.tiny import generator

from echoavatar.models.generator import GeneratorConfig
from echoavatar.models.generator.config import Opening
from echoavatar_lab.models.generator.sequences import compact_layout
from echoavatar_lab.models.generator.stream import open_stream
from echoavatar_lab.models.tokens import prefix_prompt
from echoavatar_lab.reference.weights import REFERENCE_LAYOUT

START, END, LINE = 151_644, 151_645, 198
USER, SYSTEM, ASSISTANT = 872, 8_948, 77_091
TINY = compact_layout(audio_codes=16, motion_layers=2, motion_codes=8).model_copy(
    update={"before_example": (0, 3), "after_example": (2,)}
)


def written_out(audio: list[list[int]], motion: list[list[int]], example: list[int]) -> list[int]:
    """Chat framing with everything concatenated, as the facts describe it."""
    system = [START, SYSTEM, LINE, *example, END, LINE] if example else []
    sound = [151_690 + 1024 * q + code for frame in audio for q, code in enumerate(frame)]
    moves = [156_690 + 512 * s + code for frame in motion for s, code in enumerate(frame)]
    return [*system, START, USER, LINE, *sound, END, LINE, START, ASSISTANT, LINE, *moves]


@pytest.mark.parametrize("step", [2, 3])
@pytest.mark.parametrize("example", [[], [5, 93, 511]])
def test_every_id_of_the_prompt(step: int, example: list[int]) -> None:
    """After one step of sound: silence and the seed before it, all valid; 486 motion ids for a step of 3."""
    config = GeneratorConfig(
        layout=REFERENCE_LAYOUT, sequence="prefix", step=step, opening=Opening(silence=(7, 9), motion=32),
        width=8, layers=1, heads=1, kv_heads=1, mlp=8, steered=(6, 0),
    )  # fmt: skip
    order, frames = config.order, config.audio_frames
    random = torch.Generator().manual_seed(step)
    heard = torch.randint(1024, (frames, 2), generator=random)
    audio = torch.cat([torch.tensor([[7, 9]]).expand(300 - frames, 2), heard])
    motion = torch.full((30 - step, 3, 6), 32)
    shown = torch.tensor([[156_690 + 512 * 6 + code for code in example]]) if example else None
    ids, valid = prefix_prompt(order, audio[None], motion[None], torch.zeros(1, dtype=torch.int64), shown)
    assert bool(valid.all())
    told = [156_690 + 512 * 6 + code for code in example]
    assert ids[0].tolist() == written_out(audio.tolist(), motion.flatten(1).tolist(), told)
    assert ids.shape[1] == 8 + 600 + (540 - 18 * step) + (len(example) + 5 if example else 0)


def test_examples_and_biased_ids_are_those_of_the_release() -> None:
    """The golden table writes lower-body codes of the first layer as code - 6 x 512."""
    golden = json.loads(fixtures.golden("reference_release/actions.json").read_text())
    for name, codes in golden["state_dict"].items():
        own = [REFERENCE_LAYOUT.segment_start(6 if c >= 0 else 0) + (c if c >= 0 else c + 3072) for c in codes]
        assert own == golden["prompt"][name]["bias_ids"]
        text = "".join(f"<|motion_{token - 156_690:04d}|>" for token in own)
        assert text == golden["prompt"][name]["system_text"]


@pytest.mark.parametrize("step", [1, 2, 3])
def test_the_likeliest_codes_under_a_directive_through_a_sliding_window(step: int) -> None:
    """Three rows (no example, one code, three codes over two segments), five steps, window of six tokens."""
    model = generator(
        sequence="prefix", layout=TINY, step=step, opening=Opening(silence=(3, 4), motion=5), steered=(2, 0)
    )
    config, rows, steps = model.config, 3, 5
    members = torch.zeros(rows, 16)
    members[1, 6], members[2, [1, 4, 8 + 7]] = 1, 1
    x = torch.randint(16, (rows, steps * config.audio_frames, 2), generator=torch.Generator().manual_seed(1))
    exact = likeliest(model, x, members, 20 * members)
    for precision in ("float32", "bfloat16"):  # compiled, and by torch's own operations
        stream = open_stream(model, precision)
        state, everyone = stream.init_state(rows), torch.ones(rows, dtype=torch.bool)
        codes = stream.step(x, state, everyone, temperature=torch.zeros(rows), exemplar=members, bias=20 * members)
        assert codes.shape == (rows, steps * step, 3, 2)
        agreed = (codes == exact).float().mean()
        assert agreed == 1 if precision == "float32" else agreed > 0.5
    assert set(codes[2, :, 1, 0].tolist()) <= {1, 4}
    assert set(codes[2, :, 0, 0].tolist()) == {7}


@torch.no_grad()
def likeliest(model, x: torch.Tensor, members: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
    """Row by row, the whole window anew for every code."""
    config, out = model.config, []
    frames, layout = config.audio_frames, config.layout
    for row in range(len(x)):
        sound = [[3, 4]] * (6 * 10) + x[row].tolist()
        moves = [[5] * 6] * 6
        told = [layout.segment_start((2, 0)[c // 8]) + c % 8 for c in members[row].nonzero().flatten().tolist()]
        for end in range(frames, x.shape[1] + 1, frames):
            window = sound[end : end + 60]
            kept = moves[-(6 - config.step) :]
            ids = [*(0, 3), *told, 2] if told else []
            ids += [1] + [4 + 16 * q + code for frame in window for q, code in enumerate(frame)] + [2]
            ids += [4 + 32 + 8 * s + code for frame in kept for s, code in enumerate(frame)]
            for index in range(config.step * 6):
                hidden = model(torch.tensor([ids]))[:, -1]
                logits = (hidden @ model.segment_head()[index % 6].T)[0]
                if index % 6 in (2, 0):
                    place = (2, 0).index(index % 6) * 8
                    logits = logits + bias[row, place : place + 8]
                ids.append(4 + 32 + 8 * (index % 6) + int(logits.argmax()))
            new = [(token - 36) % 8 for token in ids[-6 * config.step :]]
            moves = moves + [new[at : at + 6] for at in range(0, len(new), 6)]
        out.append(moves[6:])
    return torch.tensor(out).view(len(x), -1, 3, 2)
