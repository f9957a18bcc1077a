"""The TypeScript types that are committed are those of the messages."""

from pathlib import Path

from echoavatar_studio.wire_types import typescript

ROOT = Path(__file__).parents[2]


def test_committed_types_are_made_from_the_messages():
    """After a change of `studio/wire*.py`: python scripts/make_studio_types.py."""
    assert (ROOT / "web/studio/src/api.generated.ts").read_text() == typescript()


def test_what_pages_need_is_there():
    text = typescript()
    for part in ("export interface RaterTask {", "export type Answer =", "export const QUESTIONS", '"bad_csrf": 403'):
        assert part in text
    assert "  is_open?: boolean;" in text  # requests may leave out what has a default
    assert "  is_repeated: boolean;" in text
