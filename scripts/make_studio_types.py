"""Write the TypeScript types of the studio's API; run after editing `studio/src/echoavatar_studio/wire*.py`."""

from pathlib import Path

from echoavatar_studio.wire_types import typescript

PATH = Path("web/studio/src/api.generated.ts")


def main() -> None:
    """Write the file."""
    target = Path(__file__).parents[1] / PATH
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(typescript(), encoding="utf-8")
    print(PATH)


if __name__ == "__main__":
    main()
