import json

from crashrate.reports.html import write_report
from crashrate.runs.record import load_run
from crashrate.runs.runner import run


def test_the_report_of_a_run_folder(build, tmp_path):
    record = build()
    folder = tmp_path / "run"
    run(record.scenario, record.traffic, folder, seed=3, max_calls=40)
    loaded = load_run(folder)
    assert len(loaded.x) == 40
    text = write_report(loaded, folder / "report.html").read_text(encoding="utf-8")
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert result["n_calls"] == 40
    assert '<td class="fact">40</td>' in text
    assert "Sections of the learned set" in text
    for alarm in result["alarms"]:
        assert alarm["message"][1:] in text.replace("&#39;", "'")
