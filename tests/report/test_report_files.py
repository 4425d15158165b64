"""The trace file, the page and what it says."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.report import html, words
from shmoo_mjx.report.style import to_png
from shmoo_mjx.report.trace import Trace, load_result, load_trace, object_index, save_trace, telling_decisions


def write_run(folder: Path, result: dict[str, Any], trace: Trace) -> None:
    (folder / "result.json").write_text(json.dumps(result), encoding="utf-8")
    save_trace(folder / "trace.npz", trace)


def test_trace_round_trip_keeps_lists_of_unequal_arrays(tmp_path: Path, trace: Trace) -> None:
    back = load_trace(save_trace(tmp_path / "trace.npz", trace))
    for name, value in trace._asdict().items():
        kept = getattr(back, name)
        if isinstance(value, tuple) and not name.endswith("_names"):
            assert len(kept) == len(value)
            for a, b in zip(kept, value, strict=True):
                assert a.shape == np.shape(b)
                np.testing.assert_allclose(a, b, atol=1e-6)
        else:
            np.testing.assert_array_equal(kept, value)
    assert [p.name for p in tmp_path.iterdir()] == ["trace.npz"]


def test_more_than_ten_plans_keep_their_order(tmp_path: Path, trace: Trace) -> None:
    plans = tuple(np.full((2, 2), float(i)) for i in range(12))
    back = load_trace(save_trace(tmp_path / "t.npz", trace._replace(plans=plans, plan_times=np.arange(12.0))))
    assert [float(p[0, 0]) for p in back.plans] == list(range(12))


def test_bad_files_are_named(tmp_path: Path, trace: Trace, result: dict[str, Any]) -> None:
    path = tmp_path / "trace.npz"
    with pytest.raises(ShmooError, match=r"trace\.npz"):
        load_trace(path)
    path.write_bytes(save_trace(path, trace).read_bytes()[:2000])
    with pytest.raises(ShmooError, match="damaged"):
        load_trace(path)
    with path.open("wb") as stream:
        np.savez(stream, t=trace.t)
    with pytest.raises(ShmooError, match="robot_pose"):
        load_trace(path)
    source = tmp_path / "result.json"
    with pytest.raises(ShmooError, match="no result"):
        load_result(source)
    source.write_text("{", encoding="utf-8")
    with pytest.raises(ShmooError, match="JSON"):
        load_result(source)
    source.write_text(json.dumps({k: v for k, v in result.items() if k != "objects"}), encoding="utf-8")
    with pytest.raises(ShmooError, match="objects"):
        load_result(source)


def test_report_is_one_self_contained_page(tmp_path: Path, trace: Trace, result: dict[str, Any]) -> None:
    write_run(tmp_path, result, trace)
    (tmp_path / "episode.mp4").write_bytes(b"film" * 10)
    page = html.write_report(tmp_path).read_text(encoding="utf-8")
    sources = re.findall(r'src="([^"]*)"', page)
    assert len(sources) == 1 + 5 and all(s.startswith("data:") for s in sources)
    assert not re.search("https?:", page)
    assert base64.b64encode(b"film" * 10).decode() in page
    assert "hands &lt;on&gt; the face" in page
    for step in result["transitions"]:
        assert f">{step['to']}</td>" in page
    assert "1.910" in page and "0.012" in page and "can&#39;t be moved" not in page.split("<h2>")[0].split("<p")[0]
    assert not list(tmp_path.glob(".*"))


@pytest.mark.usefixtures("undrawn")
def test_objects_have_one_name_and_rows_can_be_stacked_on_a_phone(trace: Trace, result: dict[str, Any]) -> None:
    for number, item in enumerate(result["objects"]):
        item["id"] = number
    result["decisions"] = [d | {"object": n, "goal": None} for n, d in enumerate(result["decisions"])]
    result["transitions"] = [
        {"t": 1.0, "from": "push", "to": "retreat", "reason": "object 1 no longer blocks the path"}
    ]
    result["objects"][0]["start_pose"] = [1.0, 2.0, -0.001]
    page = html.render_report(result, trace)
    assert "the wheelchair no longer blocks the path" in page and "object 1" not in page
    assert "(1.00, 2.00, 0°)" in page and "-0°" not in page
    body = page.partition("<body>")[2]
    assert not [cell for cell in re.findall(r"<td[^>]*>", body) if "data-label" not in cell]


@pytest.mark.usefixtures("undrawn")
def test_large_film_is_linked(
    tmp_path: Path, trace: Trace, result: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path, result, trace)
    (tmp_path / "episode.mp4").write_bytes(b"film" * 10)
    monkeypatch.setattr(html, "MAX_VIDEO_BYTES", 39)
    page = html.write_report(tmp_path).read_text(encoding="utf-8")
    assert 'src="episode.mp4"' in page and "too large" in page


def test_summary_says_what_happened(result: dict[str, Any]) -> None:
    text = words.summary(result)
    assert text.startswith("The robot reached the goal in 40 s. It pushed the box 1.1 m out of its way")
    assert "the wheelchair can't be moved (criterion K = 0.01 m²)" in text
    assert text.endswith("It never fell and never touched a wall.")
    assert "drove 9.3 m and stopped 0.14 m from the goal" in text
    for item in result["objects"]:
        assert f"It knocked the {item['family']} over." in words.summary(
            {**result, "objects": [{**item, "toppled": True}]}
        )
    failed = words.summary(
        {**result, "outcome": "no_route", "reason": "all routes are blocked.", "falls": 1, "decisions": []}
    )
    assert failed.startswith("The robot did not reach the goal: all routes are blocked.")
    assert failed.endswith("It fell once and never touched a wall.")


def test_summary_tells_chances_in_plain_words(result: dict[str, Any]) -> None:
    first = result["decisions"][0] | {"K": None, "G": None, "probability": 0.78}
    text = words.summary({**result, "decisions": [first, first | {"probability": 0.95}]}).replace("\xa0", " ")
    assert "a 78 % chance that the box can be moved out of the way, at its end 95 %" in text
    assert "P =" not in text and "object" not in text


def test_objects_of_one_family_are_numbered(result: dict[str, Any]) -> None:
    boxes = [{**item, "family": "box", "id": number} for number, item in enumerate(result["objects"])]
    result["objects"] = [*boxes, {**boxes[0], "family": "cart", "id": 2}]
    assert [words.object_name(result, number) for number in range(4)] == ["box 1", "box 2", "cart", "object 3"]
    assert words.by_name(result, "object 1 hit object 2: 5%") == "box 2 hit the cart: 5\xa0%"


def test_the_summary_says_which_objects_needed_no_decision(result: dict[str, Any]) -> None:
    item = result["objects"][1] | {"registered": False, "toppled": False}
    still = item | {"final_pose": item["start_pose"]}
    mine = [d for d in result["decisions"] if d["object"] == item["id"]]
    for decisions, told in ((mine, "where it was"), ([], "never stood in its way")):
        text = words.summary({**result, "objects": [still], "decisions": decisions})
        assert told in text and "pushed" not in text


def test_an_object_is_an_obstacle_only_while_the_robot_takes_it_for_one(result: dict[str, Any]) -> None:
    result["objects"] = [{**item, "id": number} for number, item in enumerate(result["objects"])]
    given_up = "object 1: go round 9 s; registered as an obstacle"
    result["decisions"] = [{**result["decisions"][1], "object": 1, "t": 4.0}]
    result["transitions"] = [{"t": t, "from": "push", "to": "replan", "reason": given_up} for t in (10.0, 30.0)]
    again = "every route is blocked: object 1, registered as an obstacle, is looked at again"
    result["events"] = [{"t": 20.0, "what": again}]
    state = [words.registered_at(result, 1, t) for t in (4.0, 9.0, 10.0, 19.0, 20.0, 29.0, 30.0)]
    assert state == [False, False, True, True, False, False, True]
    assert not any(words.registered_at(result, 0, t) for t in (0.0, 50.0))


def test_without_words_about_it_an_obstacle_is_one_from_the_last_change_of_mind_on(result: dict[str, Any]) -> None:
    first = result["decisions"][1]
    for t, moves in ((31.0, True), (33.0, False)):
        result["decisions"].append(first | {"t": t, "manipulable": moves})
    assert [words.registered_at(result, "chair-2", t) for t in (30.0, 32.0, 33.0)] == [False, False, True]


@pytest.mark.usefixtures("undrawn")
def test_captions_say_what_the_robot_does(trace: Trace, result: dict[str, Any]) -> None:
    options = [
        {"text": "push from behind", "works_s": 20.0, "mean_s": 24.0, "probability": 0.92},
        {"text": "go round", "works_s": 31.0, "mean_s": 31.0, "probability": 1.0},
    ]
    result["decisions"][0] |= {"K": None, "G": None, "probability": 0.92, "options": options}
    does, why = words.caption_at(result, 13.5)
    assert does.replace("\xa0", " ") == "pushes the box aside: 92 % sure it moves"
    assert why == "expected time to the goal: push from behind 24 s, go round 31 s"
    del options[1]
    assert "push from behind 20 s if it works" in words.caption_at(result, 13.5)[1]
    assert words.caption_at({**result, "transitions": []}, 1.0) == ("", "")
    page = html.render_report(result, trace)
    assert "push from behind: <b>20 s if it works</b>, 92\xa0%" in page


def test_the_axis_of_an_estimate_fits_its_later_part(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    wild = trace.learned.copy()
    wild[(trace.t > 12) & (trace.t < 13)] = 5000.0
    panels = figures.learned_figure(result, trace._replace(learned=wild)).axes
    assert 24.5 < panels[0].get_ylim()[1] < 40.0 and panels[2].get_ylim()[1] < 15.0


def test_all_pushes_are_drawn(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    often = trace._replace(learned_object=np.where((trace.t // 1.5) % 2 > 0, 0, -1))
    count = len(figures._pushes(often))
    assert count > 10
    for width in (figures.WIDE, figures.NARROW):
        assert len(figures.learned_figure(result, often, width).axes) == 2 * count


def test_a_goal_is_drawn_with_its_yaw_only_where_it_counts(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    outlines = figures.decision_figure(result, trace, 0).axes[0].patches
    assert len(outlines) == 1  # that of the object
    posed = {**result, "push_to": [5.0, 2.0, 0.3]}
    before, after = (len(figures.map_figure(run, trace).axes[0].patches) for run in (result, posed))
    assert after == before + 1


@pytest.mark.usefixtures("undrawn")
def test_long_pushes_show_only_the_telling_decisions(trace: Trace, result: dict[str, Any]) -> None:
    first, last = result["decisions"]
    verdicts = [True, True, False, True, True, True]
    result["decisions"] = [first | {"t": 13.0 + k, "manipulable": v} for k, v in enumerate(verdicts)] + [last]
    assert telling_decisions(result) == [0, 2, 3, 5, 6]
    page = html.render_report(result, trace)
    assert page.count('alt="Decision') == 5 and "Decision 6:" in page and "Decision 2:" not in page
    assert "changed the verdict" in page and page.count("1.910") == 6


def test_report_of_a_run_that_ended_at_once(tmp_path: Path, trace: Trace, result: dict[str, Any]) -> None:
    bare: dict[str, Any] = {"outcome": "failed", "transitions": [], "decisions": [], "objects": []}
    sampled: dict[str, Any] = {
        k: v[:1] for k, v in trace._asdict().items() if isinstance(v, np.ndarray) and len(v) == len(trace.t)
    }
    short = trace._replace(**sampled)._replace(
        object_pose=np.zeros((1, 0, 3)),
        learned=np.zeros((1, 0)),
        learned_names=(),
        plans=(),
        plan_times=np.zeros(0),
        decision_rollouts=(),
        decision_candidates=(),
        learned_object=np.array([-1]),
    )
    write_run(tmp_path, bare, short)
    page = html.write_report(tmp_path).read_text(encoding="utf-8")
    assert "No decision was needed." in page and "The scene held no object." in page
    assert "What it learned" not in page


def test_unknown_k_and_missing_evidence_are_drawn_all_the_same(trace: Trace, result: dict[str, Any]) -> None:
    result["decisions"][0] |= {"K": None, "G": None, "goal": [4.0, 1.5]}
    page = html.render_report(result, trace._replace(decision_rollouts=(), decision_candidates=()))
    assert page.count("<img") == 5 and page.count("to be tried") == 1


def test_objects_that_were_not_perceived_yet_do_no_harm(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures, video

    poses = trace.object_pose.copy()
    poses[:350, 1] = np.nan
    unseen = trace._replace(object_pose=poses)
    axes = figures.decision_figure(result, unseen, 1).axes[0]
    assert axes.get_xlim()[0] < 5.8 < axes.get_xlim()[1]
    assert video.topdown_image(video.top_down(result, unseen, (200, 150)), 10.0).shape == (150, 200, 3)


def test_figures_show_where_things_are(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    axes = figures.map_figure(result, trace).axes[0]
    assert 0.0 >= axes.get_xlim()[0] > -0.2 and 8.2 > axes.get_xlim()[1] >= 7.9
    corners = np.concatenate([p.get_xy() for p in axes.patches if hasattr(p, "get_xy")])
    assert np.linalg.norm(corners - (4.3 + 0.25 * np.cos(0.1) - 0.3 * np.sin(0.1), 1.8235), axis=1).min() < 0.05
    labels = [text.get_text() for text in axes.texts]
    assert "1: K = 1.91 m²" in labels and "2: K = 0.01 m²" in labels
    assert "wheelchair, can't be moved" in labels


def test_what_was_learned_has_a_column_per_push(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    panels = figures.learned_figure(result, trace).axes
    assert len(panels) == 2 * 2
    assert [p.get_title() for p in panels[:2]] == ["box", "wheelchair"]
    drawn = [line for line in panels[0].lines if str(line.get_label()).startswith("along")]
    x = np.asarray(drawn[0].get_xdata(), dtype=float)
    assert len(drawn) == 2 and 12.0 < x[0] < 12.3 and 19.8 < x[-1] < 20.1
    most = dict(zip(trace.learned_names, trace.learned[trace.t > 12.0][0], strict=True))["friction_x"]
    np.testing.assert_allclose(np.asarray(drawn[0].get_ydata(), dtype=float)[0], most)


def test_the_true_values_are_drawn_where_they_are_known(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    panels = figures.learned_figure(result, trace).axes
    true = [[line.get_ydata()[0] for line in p.lines if line.get_label() == "true value"] for p in panels]
    assert true == [[23.5, 24.5], [], [6.0], []]


def test_coefficients_are_drawn_where_they_are_what_adapts(trace: Trace, result: dict[str, Any]) -> None:
    from shmoo_mjx.report import figures

    plain = trace._replace(
        learned=np.tile(trace.learned[:, :1], 18), learned_names=tuple(f"a{k + 1}" for k in range(18))
    )
    drawn = [line for line in figures.learned_figure(result, plain).axes[0].lines if str(line.get_label())[0] == "a"]
    assert len(drawn) == 6
    assert max(np.abs(np.asarray(line.get_ydata(), dtype=float)).max() for line in drawn) <= 1.0


def test_figures_are_png_images(trace: Trace, result: dict[str, Any]) -> None:
    from PIL import Image

    from shmoo_mjx.report import figures

    for figure in (figures.learned_figure(result, trace), figures.timeline_figure(result, trace)):
        image = Image.open(io.BytesIO(to_png(figure, dpi=50)))
        assert image.format == "PNG" and image.size[0] == 450
    assert object_index(result, "chair-2") == 1 and object_index(result, "none") is None
