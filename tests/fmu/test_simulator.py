"""Somebody's FMU: its variables understood, driven by recordings, its parameters fitted."""

import ctypes
import math
import subprocess
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt
import pytest

import eps_hil
from eps_hil.cli.main import main
from eps_hil.errors import EpsHilError, InputError
from eps_hil.fmu.described import read_fmu
from eps_hil.fmu.drive import opened
from eps_hil.fmu.export import export_fmu
from eps_hil.fmu.mapping import Link, map_fmu
from eps_hil.fmu.traces import read_values, traces_of
from eps_hil.physics.model import Model, load_model
from eps_hil.physics.simulate import simulate
from eps_hil.recordings.foreign import Column, Columns
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series

pytest.importorskip("fmpy")

Floats = npt.NDArray[np.float64]
MODEL_PATH = Path(__file__).parents[2] / "configs/reference_rig.yaml"
MODEL = load_model(MODEL_PATH)
Signals = Mapping[str, Series]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "drive.fmu"
    export_fmu(MODEL, path)
    return path


@pytest.fixture
def other(drive: Path, tmp_path: Path) -> Callable[..., Path]:
    """``other({"old": "new", …})``: the drive's FMU with other words in its description."""

    def made(words: Mapping[str, str], without: str = "binaries/none") -> Path:
        path = tmp_path / "other.fmu"
        with zipfile.ZipFile(drive) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                content = old.read(name)
                if name == "modelDescription.xml":
                    text = content.decode()
                    for before, after in words.items():
                        assert before in text
                        text = text.replace(before, after)
                    content = text.encode()
                if not name.startswith(without):
                    new.writestr(name, content)
        return path

    return made


def recording(
    model: Model, seconds: float = 6.0, seed: int = 1, speed_noise: float = 0.1
) -> dict[str, Series]:
    """A rig that is held by a soft controller; sensors as late as the model file says."""
    rng = np.random.default_rng(seed)
    t = np.asarray(np.arange(round(seconds * 1000)) * 1e-3, np.float64)
    motor: Floats = 0.9 * np.sin(2 * np.pi * 0.8 * t + seed) + 0.3 * np.sin(2 * np.pi * 3.1 * t)
    force: Floats = 900.0 * np.sin(2 * np.pi * 0.8 * t + seed - 0.4)
    motion = simulate(model, t, motor, 0.0 * t, force)
    late = model.delays_s

    def told(value: np.ndarray, late_s: float, sigma: float) -> Series:
        noisy = np.interp(t - late_s, t, value) + sigma * rng.standard_normal(len(t))
        return Series(np.round(t * 1e9).astype(np.int64), noisy)

    return {
        "motor_torque_nm": told(motor, late.motor_torque, 2e-3),
        "torque_sensor_nm": told(0.0 * t, 0.0, 0.01),
        "rack_force_n": told(force, late.rack_force, 3.0),
        "motor_speed_rad_s": told(motion.speed_rad_s, late.motor_speed, speed_noise),
        "motor_angle_rad": told(motion.angle_rad, late.motor_speed, 1e-3),
    }


def write(path: Path, signals: Signals) -> str:
    first = next(iter(signals.values()))
    table = np.column_stack([first.t_ns * 1e-9, *(one.value for one in signals.values())])
    header = ",".join(["time_s", *signals])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    return str(path)


def test_names_of_another_tool_are_understood_by_words_and_unit(
    other: Callable[..., Path],
) -> None:
    path = other({
        '"motor_torque_nm"': '"T_mot"', '"torque_sensor_nm"': '"steering.torsionBar.tau"',
        '"rack_force_n"': '"F_rack"', '"motor_speed_rad_s"': '"rotor.w"',
        '"motor_angle_rad"': '"phiMotor"', '"rack_position_m"': '"rackTravel"',
        "start_motor": "first",
    })  # fmt: skip
    found = map_fmu(read_fmu(path))
    assert {n: one.variable.name for n, one in {**found.inputs, **found.outputs}.items()} == {
        "motor_torque_nm": "T_mot",
        "torque_sensor_nm": "steering.torsionBar.tau",
        "rack_force_n": "F_rack",
        "motor_speed_rad_s": "rotor.w",
        "motor_angle_rad": "phiMotor",
        "rack_position_m": "rackTravel",
    }
    assert found.open == ()
    assert not found.start


def test_units_are_those_that_the_fmu_declares(other: Callable[..., Path]) -> None:
    base = '<Unit name="rad/s">\n      <BaseUnit rad="1" s="-1"'
    rpm = other({base: f'{base} factor="0.5"'})
    assert map_fmu(read_fmu(rpm)).outputs["motor_speed_rad_s"].scale == 0.5


@pytest.mark.parametrize(
    ("unit", "base", "expected"),
    [
        ("N.m", 'kg="1" m="2" s="-2"', ("torque", (1.0, 0.0))),
        ("J", 'kg="1" m="2" s="-2"', ("something else", (1.0, 0.0))),
        ("N.m/deg", 'kg="1" m="2" s="-2" rad="-1"', ("something else", (1.0, 0.0))),
        ("deg", 'rad="1" factor="0.5"', ("angle", (0.5, 0.0))),
        ("rad", "", ("angle", (1.0, 0.0))),
        ("%", 'factor="0.01"', ("something else", (0.01, 0.0))),
        ("-", "", (None, None)),
        ("rad/s", 's="-1"', ("angular speed", (1.0, 0.0))),
        ("rpm", 's="-1" factor="0.0166667"', ("angular speed", (math.pi / 30.0, 0.0))),
        ("Hz", 's="-1"', ("something else", (1.0, 0.0))),
        ("1/s", 's="-1"', (None, None)),
        ("K", 'K="1"', ("temperature", (1.0, -273.15))),
        ("degC", 'K="1" offset="273.15"', ("temperature", (1.0, 0.0))),
        ("degF", 'K="1" factor="0.5" offset="255.0"', ("temperature", (0.5, 255.0 - 273.15))),
    ],
)
def test_what_a_unit_measures(
    other: Callable[..., Path], unit: str, base: str, expected: tuple[str | None, object]
) -> None:
    ours = '<Unit name="rad/m">\n      <BaseUnit rad="1" m="-1" />'
    path = other(
        {ours: f'<Unit name="{unit}"><BaseUnit {base}/>', 'unit="rad/m"': f'unit="{unit}"'}
    )
    one = read_fmu(path).variables["pinion_ratio_rad_per_m"]
    assert (one.quantity, one.to_si) == expected


def test_a_frequency_and_a_share_are_no_motion(other: Callable[..., Path]) -> None:
    path = other({
        '"motor_speed_rad_s"': '"f_pwm"', '"motor_angle_rad"': '"duty"', "start_motor": "first",
        '<Unit name="rad/s">\n      <BaseUnit rad="1" s="-1"': '<Unit name="Hz"><BaseUnit s="-1"',
        '<Unit name="rad">\n      <BaseUnit rad="1"': '<Unit name="%"><BaseUnit factor="0.01"',
        'unit="rad/s"': 'unit="Hz"', 'unit="rad"': 'unit="%"',
    })  # fmt: skip
    with pytest.raises(InputError, match="no output is known as rotor speed or angle"):
        map_fmu(read_fmu(path))


def test_a_mapping_goes_before_guesses_and_turns_signs(drive: Path) -> None:
    columns = Columns({"rack_force_n": Column("rack_force_n", scale=-1.0)})
    with opened(drive) as plain, opened(drive, columns) as turned:
        assert "sign turned" in " ".join(turned.notes())
        given = recording(MODEL, 1.0)
        one, two = (sim.trace(given, MODEL)["rack_force_n"] for sim in (plain, turned))
        assert np.allclose(one.value, two.value)  # what is told is ours
        t_ns = plain.grid(given, MODEL)
        first, second = (
            sim.inputs(given, MODEL, t_ns)[:, list(sim.mapped.inputs).index("rack_force_n")]
            for sim in (plain, turned)
        )
        assert np.allclose(first, -second)


def test_a_scale_counts_from_the_fmus_own_unit_as_it_does_in_a_table(
    other: Callable[..., Path],
) -> None:
    base = '<Unit name="rad/s">\n      <BaseUnit rad="1" s="-1"'
    rpm = read_fmu(other({base: f'{base} factor="0.5"'}))

    def link(scale: float = 1.0, offset: float = 0.0) -> Link:
        column = Column("motor_speed_rad_s", scale, offset)
        return map_fmu(rpm, Columns({"motor_speed_rad_s": column})).outputs["motor_speed_rad_s"]

    assert (link(scale=0.5, offset=2.0).scale, link(scale=0.5, offset=2.0).offset) == (0.5, 2.0)
    assert "as the mapping says, times 0.5" in link(scale=0.5).said()
    assert [link().scale, link(scale=-1.0).scale] == [0.5, -0.5]  # by the declared unit
    with pytest.raises(InputError, match=r"has an offset, and .* is in rad/s; give its scale, too"):
        link(offset=2.0)


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"motor_speed_rad_s": "motor_sped"}, "variable 'motor_sped': is no input or output of it; "
         "did you mean"),
        ({"rack_force_n": "torque_sensor_nm"}, "is in N.m, rack_force_n (N) was expected"),
    ],
)  # fmt: skip
def test_a_mapping_that_is_wrong_is_refused(
    columns: Mapping[str, str], expected: str, drive: Path
) -> None:
    with pytest.raises(InputError, match=expected.replace("(", r"\(").replace(")", r"\)")):
        map_fmu(read_fmu(drive), Columns({n: Column(one) for n, one in columns.items()}))


def test_an_fmu_that_nobody_can_run_here_is_refused(
    other: Callable[..., Path], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_fmu(tmp_path / "none.fmu")
    (tmp_path / "text.fmu").write_text("no zip", encoding="utf-8")
    with pytest.raises(InputError, match="is no FMU"):
        read_fmu(tmp_path / "text.fmu")
    with pytest.raises(InputError, match="has no binary, this machine needs"):
        read_fmu(other({}, without="binaries"))
    words = {'"motor_speed_rad_s"': '"a"', '"motor_angle_rad"': '"b"', "start_motor": "first"}
    units = {'rad="1" s="-1"': 'A="1"', '<BaseUnit rad="1" />': '<BaseUnit K="1" />'}
    with pytest.raises(InputError, match="no output is known as rotor speed or angle"):
        map_fmu(read_fmu(other({**words, **units})))


def test_a_failure_says_when_and_what_the_fmu_said(drive: Path) -> None:
    with opened(drive) as simulator:
        given = simulator.inputs(recording(MODEL, 1.0), MODEL, np.arange(1000) * 1_000_000)
        given[500:, 0] = np.nan
        with pytest.raises(EpsHilError, match=r"fails at 0\.499 s: the motion is no number"):
            simulator.run(given)
        with pytest.raises(EpsHilError, match="does not start: inertia_kg_m2 is -1"):
            simulator.run(given[:5], {"inertia_kg_m2": -1.0})


def test_kept_at_the_recorded_motion_the_right_simulator_needs_no_torque(drive: Path) -> None:
    given = recording(MODEL)
    (trace,) = traces_of(drive, {"a.csv": given}, MODEL)[0].values()
    speed = trace["motor_speed_rad_s"]
    seen = np.interp(speed.t_ns + 4e6, given["motor_speed_rad_s"].t_ns,
                     given["motor_speed_rad_s"].value)  # fmt: skip
    assert np.std(seen - speed.value) < 0.2
    with opened(drive) as simulator:
        t_ns = simulator.grid(given, MODEL)
        inputs = simulator.inputs(given, MODEL, t_ns)
        right, wrong = (
            simulator.run(inputs, values, None, simulator.follow(given, MODEL, t_ns))[1]
            for values in ({}, {"friction.offset_pos_nm": 0.09})
        )
    assert np.std(right[300:-1]) < 0.004 < 0.5 * np.std(wrong[300:-1])


def _with_source(
    path: Path, out: Path, change: Callable[[str], str], main_name: str = "fmi2.c"
) -> Path:
    """The exported FMU, its C changed and compiled anew."""
    folder = out.parent / "source"
    with zipfile.ZipFile(path) as old:
        old.extractall(folder)
    main_c = folder / "sources" / main_name
    main_c.write_text(change(main_c.read_text(encoding="utf-8")), encoding="utf-8")
    library = next(folder.glob("binaries/*/*.so"))
    library.unlink()
    command = ["cc", "-shared", "-fPIC", "-o", str(library), str(main_c), "-lm"]
    subprocess.run(command, check=True)
    with zipfile.ZipFile(out, "w") as new:
        for one in folder.rglob("*"):
            new.write(one, str(one.relative_to(folder)))
    return out


def test_what_an_fmu_prints_is_not_our_output(
    drive: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    talks = "EXPORT Status FMI(fmi2Terminate)(void *c) { (void)c;"
    path = _with_source(
        drive, tmp_path / "talks.fmu", lambda text: text.replace(talks, talks + ' puts("ended");')
    )
    traces_of(path, {"a.csv": recording(MODEL, 1.0)}, MODEL)
    ctypes.CDLL(None).fflush(None)
    assert capfd.readouterr().out == ""
    print("said", flush=True)
    assert capfd.readouterr().out == "said\n"


def test_an_angle_that_begins_anew_each_turn_is_unwrapped(drive: Path, tmp_path: Path) -> None:
    plain = "    return get(c, vr, n, value);\n"
    wrapped = """    size_t k; Status status = get(c, vr, n, value);
    for (k = 0; k < n; k++)
        if (vr[k] == GIVEN + 1) value[k] = remainder(value[k], 6.283185307179586);
    return status;
"""
    path = _with_source(drive, tmp_path / "anew.fmu", lambda text: text.replace(plain, wrapped))
    given = recording(MODEL, 2.0)
    one, two = (
        next(iter(traces_of(fmu, {"a.csv": given}, MODEL)[0].values())) for fmu in (drive, path)
    )
    assert np.ptp(one["motor_angle_rad"].value) > 2.0 * np.pi
    for name in ("motor_angle_rad", "motor_speed_rad_s", "motor_torque_nm"):
        turned = one[name].value - two[name].value
        assert np.allclose(turned, turned[0], atol=1e-6)


def test_switches_are_named_and_can_be_set(other: Callable[..., Path], tmp_path: Path) -> None:
    switches = """<ScalarVariable name="eps_on" valueReference="900" causality="input"
        variability="discrete"><Boolean start="false"/></ScalarVariable>
      <ScalarVariable name="gear" valueReference="901" causality="parameter"
        variability="fixed"><Integer start="3"/></ScalarVariable></ModelVariables>"""
    head = "EXPORT Status FMI(fmi2Set{0})(void *c, const Reference vr[], size_t n, const {0} v[])"
    words = {
        '#include "instance.h"\n': '#include "instance.h"\nstatic int on, gear = 3;\n',
        "NONE_OF(fmi2SetBoolean, const Boolean)": head.format("Boolean")
        + "{ (void)c; on = n == 1 && vr[0] == 900 && v[0]; return OK; }",
        "NONE_OF(fmi2SetInteger, const Integer)": head.format("Integer")
        + "{ (void)c; gear = n == 1 && vr[0] == 901 ? v[0] : 0; return OK; }",
        "    (void)noSet;\n": '    if (!on || gear != 4) return complain(c, "is off");\n',
    }

    def change(text: str) -> str:
        for before, after in words.items():
            assert before in text
            text = text.replace(before, after)
        return text

    path = _with_source(other({"</ModelVariables>": switches}), tmp_path / "on.fmu", change)
    given = {"a.csv": recording(MODEL, 1.0)}
    with opened(path) as simulator:
        assert simulator.notes()[-1] == "inputs that stay at their start: eps_on (false)"
    with pytest.raises(EpsHilError, match="is off"):
        traces_of(path, given, MODEL, values={"gear": 4.0})
    (tmp_path / "on.yaml").write_text("eps_on: true\ngear: 4\n")
    assert len(traces_of(path, given, MODEL, values=read_values(tmp_path / "on.yaml"))[0]) == 1
    for values, said in (
        ({"eps_on": 2.0}, "is 2.0, true or false was expected"),
        ({"gear": 1.5}, "is 1.5, a whole number was expected"),
        ({"inertia_kg_m2": True}, "is True, a number was expected"),
        ({"motor_torque_nm": 1.0}, "is no parameter, and no input without a signal"),
    ):
        with pytest.raises(InputError, match=said):
            traces_of(path, given, MODEL, values=values)


def test_the_cause_is_told_and_not_what_an_fmu_says_when_it_is_taken_down(
    drive: Path, tmp_path: Path
) -> None:
    old = "EXPORT Status FMI(fmi2Terminate)(void *c) {"
    path = _with_source(
        drive, tmp_path / "moans.fmu",
        lambda text: text.replace(old, old + ' complain(c, "illegal sequence");'),
    )  # fmt: skip
    with opened(path) as simulator:
        given = simulator.inputs(recording(MODEL, 1.0), MODEL, np.arange(9) * 1_000_000)
        with pytest.raises(EpsHilError, match="does not start: inertia_kg_m2 is -1"):
            simulator.run(given, {"inertia_kg_m2": -1.0})


def test_an_array_is_no_signal(tmp_path: Path) -> None:
    export_fmu(MODEL, tmp_path / "a.fmu", fmi=3)
    with (
        zipfile.ZipFile(tmp_path / "a.fmu") as old,
        zipfile.ZipFile(tmp_path / "b.fmu", "w") as new,
    ):
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                text = content.decode()
                at = text.index("/>", text.index('name="motor_angle_rad"'))
                content = (
                    text[:at] + '><Dimension start="3"/></Float64>' + text[at + 2 :]
                ).encode()
            new.writestr(name, content)
    found = map_fmu(read_fmu(tmp_path / "b.fmu"))
    assert "motor_angle_rad" not in found.outputs
    assert "motor_speed_rad_s" in found.outputs


def test_an_fmu_that_ends_the_simulation_is_believed(tmp_path: Path) -> None:
    export_fmu(MODEL, tmp_path / "third.fmu", fmi=3)
    goes_on = "*event = *end = *early = false;"
    ends = "*event = *early = false; *end = time > 0.4995;"
    path = _with_source(
        tmp_path / "third.fmu", tmp_path / "ends.fmu",
        lambda text: text.replace(goes_on, ends), "fmi3.c",
    )  # fmt: skip
    with pytest.raises(EpsHilError, match=r"ends the simulation after 0\.501 s"):
        traces_of(path, {"a.csv": recording(MODEL, 1.0)}, MODEL)


@pytest.mark.parametrize(
    ("words", "step_s"),
    [
        ("", 1e-3),
        ('fixedInternalStepSize="0.0004"', 0.8e-3),
        ('fixedInternalStepSize="0.0025"', 2.5e-3),
    ],
)
def test_the_step_is_a_multiple_of_the_fmus_own(tmp_path: Path, words: str, step_s: float) -> None:
    export_fmu(MODEL, tmp_path / "third.fmu", fmi=3)
    with (
        zipfile.ZipFile(tmp_path / "third.fmu") as old,
        zipfile.ZipFile(tmp_path / "fixed.fmu", "w") as new,
    ):
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b"<CoSimulation ", f"<CoSimulation {words} ".encode())
            new.writestr(name, content)
    with opened(tmp_path / "fixed.fmu") as simulator:
        assert simulator.step_s == pytest.approx(step_s)


def test_a_types_bounds_are_its_variables(other: Callable[..., Path]) -> None:
    types = '<TypeDefinitions><SimpleType name="I"><Real min="0.5" max="2"/></SimpleType>'
    path = other({
        "<LogCategories>": f"{types}</TypeDefinitions><LogCategories>",
        'min="1e-12" max="1000000000000.0" start="0.0002"': 'declaredType="I" max="1" start="0.7"',
    })  # fmt: skip
    assert read_fmu(path).variables["inertia_kg_m2"].bounds == (0.5, 1.0)


def test_recordings_of_one_name_have_a_trace_each(drive: Path) -> None:
    given = recording(MODEL, 1.0)
    traces, _ = traces_of(drive, {"a/run.csv": given, "b/run.csv": given}, MODEL)
    assert list(traces) == [f"{drive.name} on {each}/run.csv" for each in "ab"]


def test_fmi_3_gives_the_trace_of_fmi_2(drive: Path, tmp_path: Path) -> None:
    export_fmu(MODEL, tmp_path / "third.fmu", fmi=3)
    given = recording(MODEL, 3.0)
    two, three = (
        next(iter(traces_of(path, {"a.csv": given}, MODEL)[0].values()))
        for path in (drive, tmp_path / "third.fmu")
    )
    for name in ("motor_speed_rad_s", "motor_angle_rad"):  # FMI 3 has no slopes of inputs
        apart = np.abs(two[name].value - three[name].value).max()
        assert apart < 1e-2 * np.ptp(two[name].value)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.yaml", "a: 1\nb: 2\na: 3\n", "line 3, .*'a' stands here and on line 1"),
        ("a.json", '{"a": 1, "b": 2, "a": 3}', "'a' stands twice"),
        ("a.json", "[1", "Expecting"),
        ("a.yaml", "a: [1\n", "not valid YAML"),
    ],
)
def test_values_that_cannot_be_meant_are_refused(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=said):
        read_values(tmp_path / name)


@pytest.mark.slow
def test_its_parameters_are_found_with_intervals_and_the_gain_on_what_was_kept(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    friction = replace(MODEL.friction, offset_pos_nm=0.08)
    rig = replace(MODEL, inertia_kg_m2=2.4e-4, friction=friction)
    path, values = write(tmp_path / "a.csv", recording(rig, 8.2)), tmp_path / "fit.json"
    words = ["identify", path, "--model", str(MODEL_PATH), "--simulation", str(drive)]
    words += ["--free", "friction.offset_pos_nm", "inertia_kg_m2=1e-5:1e-3", "--json", str(values)]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "every 4th stretch of 2 s" in said.out
    assert "motor_torque_nm is motor_torque_nm" in said.err
    found = read_values(values)
    assert found["friction.offset_pos_nm"] == pytest.approx(0.08, rel=0.01)
    assert found["inertia_kg_m2"] == pytest.approx(2.4e-4, rel=0.02)
    far = {"friction.offset_neg_nm": 0.5}  # from what the rig has: the other bends
    bent = eps_hil.fit_simulator(path, MODEL, drive, [*found][:1], simulation_values=far)
    assert bent.values["friction.offset_pos_nm"] != pytest.approx(0.08, rel=0.05)
    rig = replace(MODEL, friction=friction)
    first, kept = (write(tmp_path / f"{seed}.csv", recording(rig, 4.0, seed)) for seed in (2, 3))
    free = ["friction.offset_pos_nm"]
    again = eps_hil.fit_simulator(first, MODEL, drive, free, holdouts=kept)
    one = again.content["parameters"]["friction.offset_pos_nm"]
    assert one["value"] == pytest.approx(0.08, rel=0.005)
    assert one["ci95"][0] < one["value"] < one["ci95"][1]
    gain = again.content["holdout"]
    assert gain["kept"] == "the hold-outs"
    assert gain["torque_rms_nm"]["after"] < 0.8 * gain["torque_rms_nm"]["before"]


@pytest.mark.slow
def test_a_noisy_speed_makes_no_simulator_heavier(drive: Path, tmp_path: Path) -> None:
    """Noise times the damping is no torque that the simulator lacks, however much there is."""
    path = write(tmp_path / "a.csv", recording(MODEL, 8.2, 3, speed_noise=5.0))
    fitted = eps_hil.fit_simulator(path, MODEL, drive, ["inertia_kg_m2=1e-5:1e-3"])
    one = fitted.content["parameters"]["inertia_kg_m2"]
    assert one["value"] == pytest.approx(MODEL.inertia_kg_m2, rel=8e-4)
    assert one["ci95"][1] - one["ci95"][0] < 1e-3 * one["value"]
    assert fitted.content["holdout"]["torque_rms_nm"]["after"] < 0.01


@pytest.mark.slow
def test_what_an_fmu_lacks_is_named(drive: Path, tmp_path: Path, other_rig: ModuleType) -> None:
    rig = other_rig.Effects({other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0})
    columns = other_rig.record(rig, "weave", 1, 1.0, 15.0)
    path = tmp_path / "a.csv"
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    found = eps_hil.diagnose(path, MODEL, simulation=drive)
    assert [one.effect for one in found.findings] == ["stribeck"]
    assert found.findings[0].parameters["level_nm"]["value"] == pytest.approx(0.04, rel=0.15)
    series = read_recording(path).series
    (trace,) = traces_of(drive, {"a.csv": series}, MODEL)[0].values()
    read = read_recording(Path(write(tmp_path / "trace.csv", trace))).series
    by_table = eps_hil.diagnose(path, MODEL, simulation={"trace": read})
    assert by_table.content["verdict"] == found.content["verdict"] == "explained"
    assert [one.effect for one in by_table.findings] == ["stribeck"]
    level, same = (one.findings[0].parameters["level_nm"] for one in (found, by_table))
    assert same["value"] == pytest.approx(level["value"], rel=1e-3)
    assert same["ci95"] == pytest.approx(level["ci95"], rel=1e-3)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["identify", "R", "--simulation", "D"], "names no parameter"),
        (["identify", "R", "--free", "x"], "goes with --simulation"),
        (["identify", "R", "--simulation", "D", "--free", "x", "--holdout", "R"],
         "is recording and hold-out"),
        (["identify", "R", "--simulation-values", "R"], "goes with --simulation"),
        (["identify", "R", "--simulation", "D", "--free", "inertia"], "did you mean 'inertia_kg"),
        (["identify", "R", "--simulation", "D", "--free", "inertia_kg_m2=1"], "no NAME=low:high"),
        (["identify", "R", "--simulation", "D", "--free", "inertia_kg_m2=3:1"],
         "has its bounds the wrong way round: 3 is not below 1"),
        (["identify", "R", "--simulation", "R", "--free", "a"], "only an FMU"),
        (["identify", "R", "--simulation", "D", "--free", "inertia_kg_m2"],
         "is too short to fit and to judge by"),
        (["diagnose", "--recording", "R", "--simulation", "none.fmu"], "no such file"),
        (["diagnose", "--recording", "R", "--simulation", "D", "R"], "stands beside other traces"),
        (["diagnose", "--recording", "R", "--simulation-values", "R"], "and an FMU"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(
    words: list[str],
    expected: str,
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    known = {"R": write(tmp_path / "a.csv", recording(MODEL, 2.5)), "D": str(drive)}
    words = [known.get(word, word) for word in words]
    assert main([*words, "--model", str(MODEL_PATH)]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("eps-hil:")]
    assert len(said) == 1
    assert expected in said[0]
