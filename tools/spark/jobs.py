#!/usr/bin/env python3
"""Campaigns, calibrations and diagnoses as Spark jobs; the results equal a run on one machine, bit for bit.

    spark-submit tools/spark/jobs.py campaign --runs 200 --seed 1 --parts 64 --json campaign.json
    spark-submit tools/spark/jobs.py diagnose 'archive/device=iras/day=*' --reference 'references/{day}.csv' --out results
    spark-submit tools/spark/jobs.py calibrate 'archive/device=iras/day=*' --reference 'references/{day}.csv' --out results

What stands after `--` are further options of the command, such as `-- --config unit.toml`. Every executor has the package `geu` (pip install)
and reads the same file system.
"""

import argparse
import glob
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import geu
from pyspark.sql import SparkSession

PARTITION = re.compile(r"([^=/]+)=([^/]+)$")


def results(session: SparkSession, jobs: list[list[str]], accepts: tuple[int, ...]) -> list[tuple[str, str]]:
    """JSON and error message of each command, in the order of the commands; a command has either. One task runs one command."""

    def run(frames: Iterator[Any]) -> Iterator[Any]:
        for frame in frames:
            texts, errors = [], []
            for words in frame["words"]:
                with tempfile.TemporaryDirectory() as directory:
                    path = Path(directory, "result.json")
                    try:
                        geu.command(*json.loads(words), json=path, accepted=accepts)
                    except geu.GeuError as error:
                        texts.append("")
                        errors.append(str(error) or "failed")
                    else:
                        texts.append(path.read_text())
                        errors.append("")
            yield frame[["place"]].assign(text=texts, error=errors)

    rows = [(place, json.dumps(words)) for place, words in enumerate(jobs)]
    frame = session.createDataFrame(rows, "place int, words string").repartition(len(rows), "place")
    found = {row.place: (row.text, row.error) for row in frame.mapInPandas(run, "place int, text string, error string").collect()}
    return [found[place] for place in range(len(jobs))]


def campaign(session: SparkSession, arguments: argparse.Namespace) -> None:
    """`geu blind campaign` in parts, and their merge."""
    options = ["--runs", str(arguments.runs), "--seed", str(arguments.seed), "--threads", "1", *arguments.options]
    jobs = [["blind", "campaign", *options, "--shard", f"{part}/{arguments.parts}"] for part in range(1, arguments.parts + 1)]
    with tempfile.TemporaryDirectory() as directory:
        paths = [Path(directory, f"{part}.json") for part in range(len(jobs))]
        for part, (path, (text, error)) in enumerate(zip(paths, results(session, jobs, (0,))), start=1):
            if error:
                sys.exit(f"part {part} of {arguments.parts}: {error}")
            path.write_text(text)
        print(geu.command("blind", "merge", *paths, json=arguments.json), end="")


def days(session: SparkSession, arguments: argparse.Namespace) -> None:
    """One calibration or diagnosis for each directory of the archive; its JSON has the name of the directory."""
    directories = sorted(path for path in glob.glob(arguments.archive) if Path(path).is_dir())
    if not directories:
        sys.exit(f"{arguments.archive}: expected directories of an archive, found none")
    jobs, names, evaluated, taken = [], [], [], set()
    for directory in directories:
        values = dict(match.groups() for part in Path(directory).parts if (match := PARTITION.match(part)))
        try:
            reference = arguments.reference.format(**values)
        except (IndexError, KeyError, ValueError) as error:
            sys.exit(f"--reference: expected names of {', '.join(values)} in braces, got {arguments.reference}: {error}")
        if not values or (name := "_".join(values.values()) + ".json") in taken:
            sys.exit(f"{directory}: expected a path with KEY=VALUE that no other directory has, such as device=iras/day=2026-11-27")
        taken.add(name)
        if (Path(arguments.out) / name).exists():
            if not arguments.resume:
                sys.exit(f"{Path(arguments.out) / name}: expected a free name; choose another --out, or give --resume to keep it")
            continue
        names.append(name)
        evaluated.append(directory)
        jobs.append([arguments.job, "--link", directory, "--reference", reference, *arguments.options])
    out = Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    # A diagnosis that stays unexplained has a result too.
    found = results(session, jobs, (0, 3) if arguments.job == "diagnose" else (0,)) if jobs else []
    for directory, name, (text, error) in zip(evaluated, names, found):
        if error:
            print(f"{directory}: {error}", file=sys.stderr)
        else:
            (out / name).write_text(text)
            print(out / name)
    if failed := sum(bool(error) for _, error in found):
        sys.exit(f"{failed} of {len(found)} directories failed; --resume evaluates these again")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    subparsers = parser.add_subparsers(dest="job", required=True)
    blind = subparsers.add_parser("campaign", help="geu blind campaign")
    blind.add_argument("--runs", type=int, default=200)
    blind.add_argument("--seed", type=int, default=1)
    blind.add_argument("--parts", type=int, default=64, help="tasks")
    blind.add_argument("--json", required=True, help="write every run as JSON")
    for job in ("calibrate", "diagnose"):
        evaluation = subparsers.add_parser(job, help=f"geu {job} of each day of an archive")
        evaluation.add_argument("archive", help="pattern of directories of days")
        evaluation.add_argument("--reference", required=True, help="reference of a directory; {day} and {device} come from its path")
        evaluation.add_argument("--out", required=True, help="directory of results")
        evaluation.add_argument("--resume", action="store_true", help="evaluate only directories without a result")
    words = sys.argv[1:]
    place = words.index("--") if "--" in words else len(words)
    arguments = parser.parse_args(words[:place])
    arguments.options = words[place + 1:]
    session = SparkSession.builder.appName(f"geu {arguments.job}").getOrCreate()
    (campaign if arguments.job == "campaign" else days)(session, arguments)
    session.stop()


if __name__ == "__main__":
    main()
