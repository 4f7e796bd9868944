# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""A recorded fused axis, its displayed state and its controls; as a script, very many changes in a given time.

python steered_support.py CHANGES SECONDS SEED
"""

from __future__ import annotations

import signal
import sys
import time

import numpy as np
from nodes_support import axis_parameters, until, write_axis

CONTROLLER, COMPENSATOR, PLANT = "motion_controller", "hysteresis_compensator", "plant_simulator"
NEAR = 5e-8
#: Slew rate [V/s] and range [V] of the axis with random changes.
SLEW, RANGE = 4e4, (-30.0, 120.0)


class Steered:
    """A recorded fused axis, its displayed state and its controls."""

    def __init__(self, processes, observer, folder, *prefix: str, compensator=None, **plant):
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Bool, Float64

        # late voltages of a busy machine must not stop the axis here
        plant = {"late_limit": -1, "preload__force": 0.0} | plant
        axis = axis_parameters(overrides={PLANT: plant, COMPENSATOR: compensator or {}}, time_mode="fused")
        self.bag, self._processes, self._observer = folder / "bag", processes, observer
        path = write_axis(folder / "axis.yaml", axis)
        command = [*prefix, sys.executable, "-m", "hysteresis_ros.cli.main", "up", path, "--record", str(self.bag)]
        self.run = processes.start(command, "up")
        self.states = observer.listen(JointState, f"/{PLANT}/state")
        self.joints = observer.listen(JointState, "/joint_states")
        self.commands = observer.listen(Float64, "/command")
        self._setpoints = observer.talk(Float64, "/setpoint")
        self._emergencies = observer.talk(Bool, "/estop")
        until(lambda: len(self.states) > 5 or self.run.popen.poll() is not None, what="an axis that runs")
        until(lambda: self._setpoints.get_subscription_count() and self._emergencies.get_subscription_count())

    def now(self, name: str) -> float:
        return dict(zip(self.states[-1].name, self.states[-1].position, strict=True))[name]

    @property
    def time(self) -> float:
        """Stamp of the last state [s]."""
        stamp = self.states[-1].header.stamp
        return stamp.sec + 1e-9 * stamp.nanosec

    def ask(self, setpoint: float) -> None:
        from std_msgs.msg import Float64

        self._setpoints.publish(Float64(data=setpoint))

    def stop_at_once(self) -> None:
        from std_msgs.msg import Bool

        self._emergencies.publish(Bool(data=True))

    def at(self, displacement: float) -> None:
        until(lambda: abs(self.now("displacement") - displacement) < NEAR, what=f"the axis at {displacement:g} m")

    def safe(self) -> None:
        until(lambda: abs(self.now("voltage")) < 0.01, what="the safe voltage")

    def verified(self) -> str:
        """Exit, and return the result of the comparison with the offline twin."""
        code, _ = self.run.leave(signal.SIGINT)
        assert code == 0, self.run.output
        check = self._processes.command("verify", str(self.bag))
        assert check.wait() == 0, check.output
        return check.output


def at_random(steered: Steered, observer, changes: int, random, pause: float = 0.0) -> list[float]:
    """Change gains, models, setpoints and active parts at random; return the time until each answer [s]."""
    from rcl_interfaces.srv import SetParametersAtomically
    from std_srvs.srv import Trigger

    for node in (CONTROLLER, COMPENSATOR, PLANT):
        observer.keep_client(SetParametersAtomically, f"/{node}/set_parameters_atomically")
        for action in ("start", "stop"):
            observer.keep_client(Trigger, f"/{node}/{action}")
    took = []
    for _ in range(changes):
        due = steered.time + pause * random.random()  # distributes the requests over the samples
        until(lambda due=due: steered.time >= due, what="later samples")
        steered.ask(random.uniform(0.0, 10e-6))
        asked = random.integers(6)
        begun = time.monotonic()
        if asked == 0:
            answer = observer.trigger(f"/{random.choice((CONTROLLER, COMPENSATOR))}/{random.choice(('stop', 'start'))}")
            assert answer.success, answer.message
        else:
            kind, gain = str(random.choice(("sliding_mode", "pid"))), random.uniform(1.0, 30.0)
            node, values = (
                (CONTROLLER, {"sliding_mode__phi": random.uniform(0.85, 0.97)}),
                (CONTROLLER, {"type": kind, "pid__Ki": gain}),
                (COMPENSATOR, {"hysteresis__polynomial__scale": random.uniform(0.97, 1.03)}),
                (PLANT, {"hysteresis__polynomial__scale": random.uniform(0.97, 1.03)}),
                (PLANT, {"sensor__noise": random.uniform(0.0, 5e-9)}),
            )[asked - 1]
            assert observer.set_parameters(f"/{node}", **values) == (True, "")
        took.append(time.monotonic() - begun)
    return took


def tame(processes, observer, folder) -> Steered:
    """Return a fused axis with a limited slew rate."""
    limits = {"limits__slew_rate": SLEW}
    return Steered(processes, observer, folder, compensator=limits, **limits)


def assert_tame(steered: Steered) -> int:
    """Refuse a run whose voltages violate range or slew rate; return its number of samples."""
    from hysteresis_ros.recordings.files import load_run

    run = load_run(steered.bag, further=True)
    voltage = run["plant_voltage"]
    assert RANGE[0] <= voltage.min() and voltage.max() <= RANGE[1]
    bit = (RANGE[1] - RANGE[0]) / 2**16
    assert np.abs(np.diff(voltage)).max() <= SLEW / 3000.0 + bit
    return len(run)


def main() -> None:
    """Execute the changes of the command line, and report the result."""
    import pathlib
    import tempfile

    from nodes_support import Observer, Processes

    changes, seconds, seed = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    domain = 90 + seed % 10
    with tempfile.TemporaryDirectory() as made:
        folder = pathlib.Path(made)
        processes, observer = Processes(folder, domain), Observer(domain)
        try:
            steered = tame(processes, observer, folder)
            begun = time.monotonic()
            took = at_random(steered, observer, changes, np.random.default_rng(seed), seconds / changes)
            lasted = time.monotonic() - begun
            print(f"{changes} changes in {lasted:.1f} s; answers {np.quantile(took, [0.5, 0.99, 1.0]) * 1e3} ms")
            print(steered.verified().strip())
            print(f"{assert_tame(steered)} samples within range and slew rate")
        finally:
            observer.close()
            processes.close()


if __name__ == "__main__":
    main()
