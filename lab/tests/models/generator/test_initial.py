"""Embeddings that know the codebooks keep their geometry; a missing Qwen2 is said plainly."""

import torch
from tests.models.generator.tiny import LAYOUT, generator

from echoavatar_lab.models.generator.initial import align_embeddings


def test_distances_between_embeddings_are_those_between_code_vectors():
    model, books = generator(), torch.randn(3, 2, 8, 5, generator=torch.Generator().manual_seed(0))
    align_embeddings(model, motion_codebooks=books)
    for segment in (0, 5):
        rows = model.model.embed_tokens.weight[LAYOUT.segment_start(segment) :][:8].detach()
        vectors = books.flatten(0, 1)[segment]
        ratio = torch.pdist(rows) / torch.pdist(vectors)
        torch.testing.assert_close(ratio, ratio.mean().expand_as(ratio))


def test_aligned_rows_have_the_scale_of_the_others_and_no_other_row_changes():
    model = generator()
    before = model.model.embed_tokens.weight.detach().clone()
    align_embeddings(model, audio_codebooks=torch.randn(2, 16, 40), scale=0.02)
    after = model.model.embed_tokens.weight.detach()
    audio_rows = after[LAYOUT.audio_base : LAYOUT.motion_base]
    assert 0.015 < float(audio_rows.std()) < 0.025
    assert torch.equal(before[LAYOUT.motion_base :], after[LAYOUT.motion_base :])
    assert torch.equal(before[: LAYOUT.audio_base], after[: LAYOUT.audio_base])
