"""Cross-validated studies: folds, what is found without the held-out fold, tables."""

from __future__ import annotations

from pathlib import Path

import pytest

from hbbatch.errors import ConfigError, DatasetError, WeightsError
from hbbatch.model.train_settings import TrainSettings
from hbbatch.runner.study import run_study
from hbbatch.runner.study_file import load_study
from hbbatch.runner.study_tables import markdown
from hbbatch.runner.train import train
from tests.tracking.real_drives import few_drives

STUDIES = Path(__file__).parents[2] / "pipelines" / "studies"
QUICK = "{noise_iterations: 2, iterations: 2, batch: 8, frames: 6}"


def study_file(folder: Path, dataset: Path, variants: str, folds: int = 2) -> Path:
    path = folder / "study.yaml"
    path.write_text(
        f"datasets: {{virconv: {dataset}}}\nfolds: {folds}\nprotocols: [gap_filled]\n"
        f"variants:\n{variants}\n"
    )
    return path


def test_a_study_judges_every_variant_on_every_labelled_sequence(
    test_data: Path, tmp_path: Path
) -> None:
    variants = (
        f"  - {{name: classical, filter: kalman, train: {QUICK}}}\n"
        f"  - {{name: learned, train: {QUICK}, track: {{association: {{cost: l2}}}}}}"
    )
    file = study_file(tmp_path, few_drives(test_data, "0000", "0003").root, variants)
    said: list[str] = []
    report = run_study(load_study(file), said.append)
    assert [row.variant for row in report.rows] == ["classical", "learned"]
    assert len(said) == 4
    labelled = {row.scores.labelled_boxes for row in report.rows}
    assert len(labelled) == 1
    assert labelled.pop() > 500
    assert all(row.scores.hota > 50 for row in report.rows)
    tables = markdown(report)
    assert "| virconv | gap_filled | car | learned | 0 |" in tables
    assert "| vehicle | 1 | 3 | 5 |" in tables
    assert "| virconv | seen from above |" in tables
    assert "| vehicle | innovation | across |" in tables
    dense = {name: [e["virconv"] for e in folds] for name, folds in report.dense.items()}
    assert list(dense)[-3:] == ["detections", "fitted causal smoother", "fitted two-sided smoother"]
    assert len({tuple(e.count for e in folds) for folds in dense.values()}) == 1


def test_what_was_trained_is_kept_and_shared(test_data: Path, tmp_path: Path) -> None:
    """Two variants that only track differently, then the same study again."""
    variants = (
        f"  - {{name: one, filter: kalman, train: {QUICK}}}\n"
        f"  - {{name: other, filter: kalman, train: {QUICK}, track: {{association: {{cost: l2}}}}}}"
    )
    file = study_file(tmp_path, few_drives(test_data, "0000", "0003").root, variants)
    first = run_study(load_study(file), keep=tmp_path / "kept")
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").glob("*.safetensors")}
    assert len(kept) == 2, "one a fold"
    again = run_study(load_study(file), keep=tmp_path / "kept")
    assert again.to_json() == first.to_json()
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    other = tmp_path / "other.yaml"
    other.write_text(file.read_text().replace("folds: 2", "folds: 2\nseeds: [1]"))
    run_study(load_study(other), keep=tmp_path / "kept")
    assert len(list((tmp_path / "kept").glob("*.safetensors"))) == 4


def test_weights_that_are_there_are_judged_without_training(
    test_data: Path, tmp_path: Path
) -> None:
    root = few_drives(test_data, "0000", "0003").root
    quick = TrainSettings(noise_iterations=2, iterations=2, batch=8, frames=6)
    train([root], tmp_path / "own.safetensors", quick, kind="kalman")
    variants = (
        "  - {name: own, filter: kalman, weights: own.safetensors}\n"
        "  - {name: shipped, filter: kalman, weights: kitti-kalman}"
    )
    report = run_study(load_study(study_file(tmp_path, root, variants)))
    own, shipped = ({e.plan_m for e in report.errors[n][0]["vehicle"]} for n in ("own", "shipped"))
    assert own != shipped
    assert [row.variant for row in report.rows] == ["own", "shipped"]


def test_datasets_trained_on_as_well_are_missed_before_anything_is_trained(
    test_data: Path, tmp_path: Path
) -> None:
    variants = f"  - {{name: first, train: {QUICK}}}\n  - {{name: second, also: [absent]}}"
    root = few_drives(test_data, "0000", "0003").root
    said: list[str] = []
    with pytest.raises(DatasetError, match="absent: no dataset here"):
        run_study(load_study(study_file(tmp_path, root, variants)), said.append)
    assert said == []


@pytest.mark.parametrize(
    ("variants", "fault"),
    [
        ("  - {name: a, train: {iteration: 3}}", "iteration"),
        ("  - {name: a, track: {output: {min_track_score: high}}}", "min_track_score"),
        ("  - {name: a, train_on: [casa]}", "casa"),
        ("  - {name: a, speed: 3}", "speed"),
        (
            "  - {name: a, weights: kitti, train: {iterations: 3}}",
            "both weights and something to train",
        ),
        ("  - {name: a, weights: kitti, also: [other]}", "both weights and something to train"),
    ],
)
def test_a_study_is_validated_as_a_whole(tmp_path: Path, variants: str, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        load_study(study_file(tmp_path, tmp_path, variants))


@pytest.mark.parametrize(
    ("variant", "fault"),
    [
        ("{name: a, weights: nowhere}", "neither shipped nor a file"),
        ("{name: a, weights: kitti-kalman}", "asked for hybrid"),
    ],
)
def test_weights_that_cannot_be_used_are_found_before_anything_runs(
    tmp_path: Path, variant: str, fault: str
) -> None:
    with pytest.raises(WeightsError, match=fault):
        load_study(study_file(tmp_path, tmp_path, f"  - {variant}"))


def test_too_many_folds_are_refused(test_data: Path, tmp_path: Path) -> None:
    file = study_file(tmp_path, few_drives(test_data, "0000", "0003").root, "  - {name: a}", 40)
    with pytest.raises(DatasetError, match="too few for 40 folds"):
        run_study(load_study(file))


@pytest.mark.parametrize("name", sorted(p.stem for p in STUDIES.glob("*.yaml")))
def test_the_studies_of_the_repository_are_valid(name: str) -> None:
    assert load_study(STUDIES / f"{name}.yaml").variants
