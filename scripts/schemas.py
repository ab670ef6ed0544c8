"""Write the JSON schemas that the example files name; ``--check`` fails where one differs."""

import json
import sys

from eps_hil.check.schemas import SCHEMAS, schema
from eps_hil.examples.shelf import SCHEMAS as FOLDER


def main() -> int:
    """Write them, or compare them."""
    different = 0
    for kind in SCHEMAS:
        path = FOLDER / f"{kind}.json"
        text = json.dumps(schema(kind), indent=1, ensure_ascii=False) + "\n"
        if "--check" in sys.argv:
            different += path.read_text(encoding="utf-8") != text
        else:
            path.write_text(text, encoding="utf-8")
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
