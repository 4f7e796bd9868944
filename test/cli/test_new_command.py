# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis new`` writes a safe and complete file, asks only on terminals, and does not overwrite a file."""

from __future__ import annotations

import io

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from hysteresis_ros.cli.commission import new
from hysteresis_ros.cli.commissioning import new_file
from hysteresis_ros.cli.commissioning.situation import plan_of
from hysteresis_ros.cli.main import main
from hysteresis_ros.configuration import load_configuration
from hysteresis_ros.loop.reach import single_axis
from hysteresis_ros.loop.simulation import simulate
from hysteresis_ros.loop.stage_parameters import StageParameters
from hysteresis_ros.loop.stage_simulation import simulate_stage

STAGE = ("--stroke", "100um", "--voltage", "-20..80 V", "--rate", "2kHz")

DRIVER = """
from hysteresis_ros.hardware.drivers.simulated import DRIVER
"""


def called(*words):
    """Run the command as a process without a terminal does."""
    return CliRunner().invoke(main, ["new", *map(str, words)])


def test_the_file_is_an_axis_in_open_loop_within_a_tenth_of_the_range(tmp_path):
    path = tmp_path / "stage.yaml"
    answer = called(path, *STAGE)
    assert answer.exit_code == 0, answer.output
    configuration = load_configuration(path)
    axis = single_axis(configuration)
    limits = axis.hysteresis_compensator.limits
    assert (limits.minimum, limits.maximum) == (-10.0, 10.0) and limits.slew_rate == 100.0
    assert axis.plant_simulator.limits == limits
    assert axis.motion_controller.type == "open_loop" and axis.hysteresis_compensator.inverse.type == "none"
    assert axis.plant_simulator.sample_rate == 2000.0 and axis.plant_simulator.driver == ""
    assert (axis.reference_generator.minimum, axis.reference_generator.maximum) == (-1e-5, 1e-5)
    plan = plan_of(configuration, axis)
    assert (plan.minimum, plan.maximum, plan.stroke) == (-20.0, 80.0, 1e-4)
    assert all("#" in line for line in path.read_text().splitlines() if "slew_rate:" in line and "limits" in line)
    # a setpoint outside the allowed range moves the axis no farther and no faster
    run = simulate(axis, duration=0.5, setpoints=np.full(1000, 1.0))
    assert run["voltage"].max() <= 10.0
    assert np.abs(np.diff(run["voltage"])).max() <= 100.0 / 2000.0 * (1.0 + 1e-9)


@pytest.mark.parametrize(("voltage", "safe", "limits"), [("20:120V", 20.0, (20.0, 30.0)), ("100", 0.0, (0.0, 10.0))])
def test_the_safe_voltage_is_zero_or_what_is_nearest_to_it(tmp_path, voltage, safe, limits):
    path = tmp_path / "stage.yaml"
    assert called(path, "--stroke", "20 um", "--voltage", voltage, "--rate", "500").exit_code == 0
    compensator = single_axis(load_configuration(path)).hysteresis_compensator
    assert compensator.safe_voltage == safe
    assert (compensator.limits.minimum, compensator.limits.maximum) == limits


def test_a_driver_beside_the_file_is_taken_with_its_options(tmp_path):
    (tmp_path / "mine.py").write_text(DRIVER)
    path = tmp_path / "stage.yaml"
    options = ("hysteresis.type=proportional", "hysteresis.proportional.gain=1e-6")
    options += ("limits.minimum=-20", "limits.maximum=80")
    words = [word for option in options for word in ("--driver-option", option)]
    answer = called(path, *STAGE, "--driver", "./mine.py", *words, "--joint", "x: y")
    assert answer.exit_code == 0, answer.output
    plant = single_axis(load_configuration(path)).plant_simulator
    assert plant.driver == str(tmp_path / "mine.py") and plant.driver_options == options and plant.joint == "x: y"
    assert yaml.safe_load(path.read_text())["/**/plant_simulator"]["ros__parameters"]["driver"] == "./mine.py"


def test_an_external_plant_is_named_in_the_file(tmp_path):
    path = tmp_path / "stage.yaml"
    assert called(path, *STAGE, "--rate", "300Hz", "--plant", "external").exit_code == 0
    assert single_axis(load_configuration(path)).plant_simulator.external_plant


WRONG = {
    "missing": (STAGE[:4], "--rate is missing"),
    "unit": (("--stroke", "100V", *STAGE[2:]), "--stroke '100V': is in V"),
    "number": (("--stroke", "far", *STAGE[2:]), "--stroke 'far'"),
    "falling": (("--stroke", "1um", "--voltage", "100:0V", "--rate", "1kHz"), "must be below the second one"),
    "negative": (("--stroke", "-1um", *STAGE[2:]), "must be 1e-09 to 0.1 m"),
    "length without a unit": (("--stroke", "60", *STAGE[2:]), "of which unit? Write 60um or 60nm"),
    "no actuator's stroke": (("--stroke", "60m", *STAGE[2:]), "--stroke: 60 m: must be"),
    "no actuator's gain": (("--stroke", "90mm", "--voltage", "0:10V", *STAGE[4:]), "90 mm over 10 V are 0.009 m/V"),
    "no actuator's rate": ((*STAGE[:4], "--rate", "2000kHz"), "--rate: 2e+06 Hz: must be"),
    "messages": ((*STAGE, "--plant", "external"), "use a sample rate of 300 Hz"),
    "driver": ((*STAGE, "--driver", "simulatd"), "did you mean simulated?"),
    "no driver there": ((*STAGE, "--driver", "./nothing.py"), "nothing.py does not exist"),
    "options alone": ((*STAGE, "--driver-option", "a=1"), "belongs to --driver"),
    "two plants": ((*STAGE, "--driver", "simulated", "--plant", "external"), "exclude each other"),
    "rate": ((*STAGE[:4], "--rate", "0Hz"), "--rate: 0 Hz"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_named_and_leaves_no_file(tmp_path, case):
    words, said = WRONG[case]
    path = tmp_path / "stage.yaml"
    answer = called(path, *words)
    assert answer.exit_code == 2 and said in answer.output, answer.output
    assert answer.output.count("\n") == 1 and not path.exists()


@pytest.mark.parametrize(
    ("stroke", "voltage", "rate", "refused"),
    [
        *[("100um", "100", rate, "") for rate in ("10Hz", "1000kHz")],
        *[("100um", "100", rate, "--rate: ") for rate in ("0.09Hz", "1010kHz")],
        *[("1nm", "100", "1kHz", ""), ("0.9nm", "100", "1kHz", "--stroke: ")],
        *[("0.1m", "200", "1kHz", ""), ("0.11m", "200", "1kHz", "--stroke: ")],
        *[("100um", "100", "5Hz", ""), ("100um", "100", "4.9Hz", "--rate: ")],
        *[("9nm", "8000", "1kHz", ""), ("9nm", "10000", "1kHz", "--stroke and --voltage: ")],
        *[("9mm", "10", "1kHz", ""), ("11mm", "10", "1kHz", "--stroke and --voltage: ")],
    ],
)
def test_values_of_another_unit_are_refused(tmp_path, stroke, voltage, rate, refused):
    """Plausible are 1 nm to 0.1 m, 1 pm/V to 1 mm/V, and 5 Hz to 1 MHz."""
    answer = called(tmp_path / "stage.yaml", "--stroke", stroke, "--voltage", voltage, "--rate", rate)
    assert answer.exit_code == (2 if refused else 0), answer.output
    assert refused in answer.output and ("check the units" in answer.output) == bool(refused)


def test_an_existing_file_is_not_touched(tmp_path):
    path = tmp_path / "stage.yaml"
    path.write_text("mine")
    answer = called(path, *STAGE)
    assert answer.exit_code == 2 and "exists already" in answer.output and path.read_text() == "mine"
    assert called(tmp_path / "stage.txt", *STAGE).exit_code == 2
    assert called(tmp_path / "no/stage.yaml", *STAGE).exit_code == 2


def test_on_a_terminal_what_is_missing_is_asked_for(tmp_path, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    # the streams that the prompts read and write
    answers = iter(["30um", "-10:90V"])
    monkeypatch.setattr("click.prompt", lambda words, default: next(answers))
    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr("sys.stdout", Terminal())
    path = tmp_path / "stage.yaml"
    new.main([str(path), "--rate", "1kHz"], standalone_mode=False)
    plan = plan_of(load_configuration(path), single_axis(load_configuration(path)))
    assert (plan.minimum, plan.maximum, plan.stroke) == (-10.0, 90.0, 30e-6)
    assert not list(answers)


COUPLED = ("--axes", "x,y", "--stroke", "50um,40um", "--voltage", "0:100V", "--rate", "5kHz")


def test_several_axes_are_a_stage_in_open_loop_whose_manual_commands_stay_in_a_tenth_of_the_range(tmp_path):
    path = tmp_path / "stage.yaml"
    answer = called(path, *COUPLED)
    assert answer.exit_code == 0, answer.output
    assert 'axes: ["x", "y"]' in path.read_text(), "the parser of ROS reads y without quotes as true"
    parameters = StageParameters.from_configuration(load_configuration(path))
    assert parameters.names == ("x", "y") and parameters.sample_rate == 5000.0
    for axis, stroke in zip(parameters.axes, (50e-6, 40e-6), strict=True):
        assert axis.motion_controller.type == "open_loop" and axis.hysteresis_compensator.inverse.type == "none"
        assert axis.plant_simulator.joint == axis.namespace.strip("/")
        limits = axis.hysteresis_compensator.limits
        assert (limits.minimum, limits.maximum, limits.slew_rate) == (0.0, 10.0, 100.0)
        assert axis.plant_simulator.limits == limits, "a stage is not driven farther than a single axis"
        assert axis.reference_generator.maximum == pytest.approx(0.1 * stroke)
        assert axis.reference_generator.approach.from_rest
        assert axis.hysteresis_compensator.hysteresis.proportional.gain == pytest.approx(stroke / 100.0)
    far = {
        name: np.full(3000, axis.reference_generator.maximum) for name, axis in zip("xy", parameters.axes, strict=True)
    }
    run = simulate_stage(parameters, setpoints=far, duration=0.6)
    for name in "xy":
        assert 0.0 < run[f"{name}/voltage"].max() <= 10.0
        assert np.abs(np.diff(run[f"{name}/voltage"])).max() <= 100.0 / 5000.0 * (1.0 + 1e-9)
        # each actuator moves its own sensor
        gain = parameters.axes["xy".index(name)].plant_simulator.hysteresis.proportional.gain
        assert run[f"{name}/displacement"].max() == pytest.approx(gain * run[f"{name}/voltage"].max(), rel=0.05)


def test_the_stage_is_commissioned_in_its_whole_range(tmp_path):
    path = tmp_path / "stage.yaml"
    assert called(path, *COUPLED).exit_code == 0
    stages = [word for stage in ("noise", "gain", "resonance", "multisine") for word in ("--stage", stage)]
    answer = CliRunner().invoke(main, ["commission", str(path), "--offline", "--yes", *stages])
    assert answer.exit_code == 0, answer.output
    # 5 % of 100 V, not of the tenth that manual commands have
    assert "x: +5 V moved the stage by 2.5 µm" in answer.output and "y: +5 V moved the stage by 2 µm" in answer.output
    # the slew rate of manual commands would reduce the multisines
    assert "at most x ±5 µm, y ±4 µm" in " ".join(answer.output.split())


def test_each_axis_of_a_stage_has_its_own_driver_option(tmp_path, monkeypatch):
    taken = {}
    monkeypatch.setattr(new_file, "write_new", lambda path, made: taken.update(made))
    words = ("--driver", "lib.so", "--driver-option", "name=/stage_{axis}", "--driver-option", "rate=1")
    assert called(tmp_path / "stage.yaml", *COUPLED, *words).exit_code == 0
    nodes = yaml.safe_load(new_file.new_stage_text(taken))
    for name in "xy":
        plant = nodes[f"/{name}/plant_simulator"]["ros__parameters"]
        assert plant["driver"] == "lib.so" and plant["driver_options"] == [f"name=/stage_{name}", "rate=1"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--axes", "x,x"), "--axes x,x: 'x' occurs more than once"),
        (("--axes", "x,2"), "'2' is not a valid namespace"),
        (("--axes", "x,"), "'' is not a valid namespace"),
        (("--axes", "x,y,z", "--stroke", "1um,2um"), "has 2 values for the 3 axes x, y, z"),
        (("--axes", "x,y", "--voltage", "0:9V,0:9V,0:9V"), "--voltage 0:9V,0:9V,0:9V: has 3 values for the 2 axes"),
        (("--axes", "x,y", "--joint", "a"), "omit --joint and --plant"),
        (("--axes", "x,y", "--plant", "external"), "omit --joint and --plant"),
        (("--axes", "x,y", "--stroke", "1um,-2um"), "--stroke"),
    ],
)
def test_a_stage_that_cannot_be_is_refused_and_not_written(tmp_path, words, said):
    path = tmp_path / "stage.yaml"
    answer = called(path, "--stroke", "50um", "--voltage", "0:100V", "--rate", "5kHz", *words)
    assert answer.exit_code == 2 and said in answer.output and len(answer.output.splitlines()) == 1, answer.output
    assert not path.exists()
