#!/usr/bin/env python3
"""Draw the figures and tables of docs/results.md and docs/identification.md from the CSV files in experiments/results/.

    source setup.bash && python3 experiments/figures.py

Figures are written to docs/images/results/ as PNG and PDF; the tables replace the marked blocks of the pages.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Dict, List, Mapping, Tuple

from identification_figures import draw_identification

from embodied_active_learning.evaluation.coverage import PLANS_WHOLE
from embodied_active_learning.evaluation.result_tables import (
    Rows,
    final_ergodic_measure,
    folded,
    group_table,
    last_value,
    markdown,
    mean_table,
    replace_block,
    row_curves,
    row_interval,
    run_table,
    stays_below,
    summary_value,
)
from embodied_active_learning.evaluation.table1 import RULES, table_lines
from embodied_active_learning.figures.curves import draw_curves
from embodied_active_learning.session.tables import COLUMNS
from embodied_active_learning.sweep.comparison import clustering_settings, compare_columns, group_records, with_unit
from embodied_active_learning.sweep.csv_files import read_rows
from embodied_active_learning.sweep.record_figures import draw_record_metrics
from embodied_active_learning.sweep.run_records import Record, has_record, load_record
from embodied_active_learning.sweep.spec import load_sweep

EXPERIMENTS = Path(__file__).resolve().parent
RESULTS, PAGE = EXPERIMENTS / "results", EXPERIMENTS.parent / "docs" / "results.md"
IMAGES = PAGE.parent / "images" / "results"
LISTED_STEPS = (100, 300, 1000)
"""Columns of the tables about ergodicity; its figure shows more."""
PLANNED_MODELS = {"default": 20, "paper": 4}
"""Number of models of Table 1 by profile."""
MEASURES = {
    "ergodic measure [nat]": final_ergodic_measure,
    "below 0.2 nat from step": stays_below("exploration", "ergodic_measure", 0.2),
    "active units": summary_value("active_units"),
    "error below 0.004 from update": stays_below("evaluation", "mse_own", 0.004),
    "error own": summary_value("mse_own"),
    "error none": summary_value("mse_none"),
    "distance [m]": summary_value("distance"),
    "control effort": last_value("exploration", "effort"),
}


def main() -> None:
    """Draw everything of which there are results."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for draw in (coverage, ergodicity, table1, pac_bayes, ablation_models):
        if (RESULTS / draw.__name__).is_dir():
            draw()
    draw_identification()
    for draw_runs in (learning_metrics, ablations, curated_objects):
        sweep = draw_runs.__name__
        records = records_of(sweep)
        lines = draw_runs(records) if records else []
        notes = missing(sweep, records), clustering_settings(records)
        replace_block(PAGE, sweep, [" ".join(filter(None, notes)), *lines])


def learning_metrics(records: List[Record]) -> List[str]:
    """Draw the paper's figure. Return the tables of means and of all runs."""
    draw_record_metrics(IMAGES / "learning_metrics.png", records)
    groups = group_records(records, "variant")
    return ["", *group_table(groups, MEASURES), "", *folded("all runs", run_table(records))]


def ablations(records: List[Record]) -> List[str]:
    """Draw the curves of the variants. Return the tables of means and of all runs."""
    groups = group_records(records, "variant")
    curves = compare_columns(groups)
    wanted = {"ergodic_measure": "exploration", "effort": "exploration", "active_units": "evaluation"}
    wanted.update(dict.fromkeys(("mse_own", "mse_shuffled", "mse_none"), "evaluation"))
    panels = {with_unit(name): curves[table, name] for name, table in wanted.items() if (table, name) in curves}
    axes = {with_unit(name): COLUMNS[table][0] for name, table in wanted.items()}
    draw_curves(IMAGES / "ablations.png", panels, axes)
    return ["", *group_table(groups, MEASURES), "", *folded("all runs", run_table(records))]


def ablation_models() -> None:
    """List the errors of the ablations' models on common views, and the successes of their fingerprints."""
    rows = read_rows(RESULTS / "ablation_models" / "ablation_models.csv")
    groups: Dict[str, List[Dict[str, str]]] = {}
    for row in rows:
        variant, _, seed = row["model"].rsplit("-", 2)  # VARIANT-WORLD-seedN
        groups.setdefault(variant, []).append({**row, "seed": seed})
    errors = ("error_everywhere", "error_near_objects")
    shares = (("kinds_learned", "kinds"), ("ranked_hits", "ranked_tests"), ("decided_hits", "decided_tests"))
    lines = [
        [
            name,
            len(members),
            *(row_interval(members, error) for error in errors),
            *("/".join(str(sum(int(row[part]) for row in members)) for part in share) for share in shares),
        ]
        for name, members in groups.items()
    ]
    header = ("variant", "models", "error everywhere", "error near objects", "kinds with fingerprints",
              "found, ranked", "found, decided")  # fmt: skip
    replace_block(PAGE, "ablation_models", markdown(header, lines))


def curated_objects(records: List[Record]) -> List[str]:
    """Return the table of all runs."""
    return ["", *run_table(records)]


def coverage() -> None:
    """Draw both measures over the length of trajectories, and list them."""
    rows = read_rows(RESULTS / "coverage" / "coverage.csv")
    panels, lines = {}, []
    for density in dict.fromkeys(row["density"] for row in rows):
        chosen = [row for row in rows if row["density"] == density]
        for name, column in (("spectral metric", "spectral"), ("KL measure [nat]", "kl")):
            panels[f"{name},\n{density}"] = row_curves(chosen, "method", "steps", column)
            lines += [f"{density}, {name}:", "", *mean_table(chosen, "method", "steps", column), ""]
    draw_curves(IMAGES / "coverage.png", panels, dict.fromkeys(panels, "steps"))
    longest = max(int(row["steps"]) for row in rows)
    timed = [row for row in rows if row["method"] in PLANS_WHOLE or int(row["steps"]) == longest]
    lines += [
        "Processor time per step [ms]; methods that do not plan the whole trajectory are timed over the longest:",
        "",
    ]
    lines += mean_table(timed, "method", "steps", "ms_per_step")
    replace_block(PAGE, "coverage", lines)


def ergodicity() -> None:
    """Draw how averages along runs approach those of independent views."""
    rows = read_rows(RESULTS / "ergodicity" / "ergodicity.csv")
    panels, lines = {}, []
    for reference in ("h", "uniform"):
        chosen: Rows = [row for row in rows if row["reference"] == reference]
        for name, column in (("error of averages [std]", "error"), ("p-value of MMD", "p_value")):
            panels[f"{name},\nagainst {reference}"] = row_curves(chosen, "explorer", "steps", column)
        listed = [row for row in chosen if int(row["steps"]) in LISTED_STEPS]
        lines += [f"Error of averages against {reference}:", "", *mean_table(listed, "explorer", "steps", "error"), ""]
        lines += [f"p-value against {reference}:", "", *mean_table(listed, "explorer", "steps", "p_value"), ""]
    draw_curves(IMAGES / "ergodicity.png", panels, dict.fromkeys(panels, "steps"))
    replace_block(PAGE, "ergodicity", lines[:-1])


def table1() -> None:
    """List the successes for each profile of the models, way of collecting images, and rule."""
    rows = read_rows(RESULTS / "table1" / "table1.csv")
    lines: List[str] = []
    for profile, images in dict.fromkeys(map(variants, rows)):
        for rule in RULES:
            chosen = [row for row in rows if variants(row) == (profile, images) and row["rule"] == rule]
            header, *cells = table_lines(chosen)
            count = len({row["model"] for row in chosen})
            name = "paper" if profile == "paper" else "default"
            lines += [
                f"Profile: {name}; images: {images}; rule: {rule}; models: {count} of {PLANNED_MODELS[name]}.",
                "",
                *markdown(header, cells),
                "",
            ]
    replace_block(PAGE, "table1", lines[:-1])


def variants(row: Mapping[str, str]) -> Tuple[str, str]:
    """Return the variants of a row of Table 1: of the model's sweep and of the images' sweep."""
    return row["model"].split("-")[0], row["images"].split("-")[0]


def pac_bayes() -> None:
    """List the terms of the bound, a column for each model and distribution."""
    rows = read_rows(RESULTS / "pac_bayes" / "pac_bayes.csv")
    header = ["term", *(f"{row['session']}, {row['distribution']}" for row in rows)]
    names = [name for name in rows[0] if name not in ("session", "distribution")]
    replace_block(PAGE, "pac_bayes", markdown(header, [[name, *(row[name] for row in rows)] for name in names]))


def records_of(sweep: str) -> List[Record]:
    """Return the records of a sweep, in the order of its runs."""
    runs = load_sweep(EXPERIMENTS / f"{sweep}.yaml").runs
    return [load_record(RESULTS / sweep / run.name) for run in runs if has_record(RESULTS / sweep / run.name)]


def missing(sweep: str, records: List[Record]) -> str:
    """Return a sentence that states which runs of a sweep are missing, with the seeds of each variant."""
    runs, made = load_sweep(EXPERIMENTS / f"{sweep}.yaml").runs, {record.name for record in records}
    absent: Dict[str, List[str]] = {}
    for name in (run.name for run in runs if run.name not in made):
        stem, _, seed = name.rpartition("-seed")
        absent.setdefault(stem, []).append(seed)
    listed = "; ".join(f"{stem} {', '.join(seeds)}" for stem, seeds in absent.items())
    return f"{len(made)} of {len(runs)} runs completed." + (f" Missing seeds: {listed}." if absent else "")


if __name__ == "__main__":
    main()
