"""Hold the survivors of a cosmic-ray session against the explained ones: python verdict.py SESSION.sqlite."""

import sys
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome

HERE = Path(__file__).parent


def explained() -> set[tuple[str, str]]:
    """(source line, operator) of every survivor that is explained."""
    lines = (HERE / "survivors.txt").read_text().splitlines()
    rows = [line.split(" | ") for line in lines if line and not line.startswith("#")]
    return {(row[0].strip(), row[1].strip()) for row in rows}


def main() -> None:
    """Print the count and every unexplained survivor; exit status 1 where there is one, or where nothing was tried."""
    known, killed, survivors = explained(), 0, []
    with use_db(sys.argv[1], WorkDB.Mode.open) as session:
        for item, result in session.completed_work_items:
            if result.test_outcome is TestOutcome.SURVIVED:
                for mutation in item.mutations:
                    line = mutation.module_path.read_text().splitlines()[mutation.start_pos[0] - 1].strip()
                    survivors.append((f"{mutation.module_path}: {line}", mutation.operator_name, result.diff or ""))
            else:
                killed += 1
    unexplained = [row for row in survivors if row[:2] not in known]
    for line, operator, diff in unexplained:
        print(f"survived: {line} | {operator}\n{diff}")
    print(f"{killed} mutants killed, {len(survivors)} survived, {len(unexplained)} of them unexplained")
    sys.exit(1 if unexplained or not killed else 0)


if __name__ == "__main__":
    main()
