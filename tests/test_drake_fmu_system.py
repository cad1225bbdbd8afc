"""FmuSystem in Drake's Simulator: a small FMU in C that is compiled here, and exported planners."""

from __future__ import annotations

import gc
import importlib
import re
import shutil
import subprocess
import sys
import tempfile
import weakref
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pydrake")
pytest.importorskip("fmpy")

import fmpy
from conftest import in_threads
from fmu_hosts.blocks import columns
from fmu_hosts.native import find_compiler
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import DiscreteTimeIntegrator, Sine, VectorLogSink, ZeroOrderHold

import contact_system as cs
from drake_plant import ContactPlanner
from drake_plant.fmu_system import FmuSystem
from fmu_export import export_fmu

VERSIONS = ("2.0", "3.0")
STEP = 0.125  # and its multiples are exact in binary
U = np.array([1.0, -2.0])
HEADERS = Path(fmpy.__file__).parent / "c-code"

# x' = gain u with x and u of two elements, by one Euler step a step; counts its steps; its Boolean
# input `on` is also an output. `copies` is the number of FMU states that are not freed. At the step
# whose number is `last` it asks to end the simulation; at -`last` a step of FMI 3 returns early.
MODEL = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if FMI == 2
#include "fmi2FunctionTypes.h"
#define F(two, three) fmi2##two
#define COUNT
typedef int Boolean;
typedef const fmi2CallbackFunctions* Logger;
#else
#include "fmi3FunctionTypes.h"
#define F(two, three) fmi3##three
#define COUNT , size_t values
typedef _Bool Boolean;
typedef fmi3LogMessageCallback Logger;
#endif

typedef struct { double time, gain, limit, last, u[2], x[2]; int on, count; } Model;
// Once categories are chosen it says nothing, as a tool whose messages have none.
typedef struct { Model model; Logger log; void* environment; int chosen; } Instance;
typedef unsigned Reference;
#define M (((Instance*)c)->model)
static const Model FRESH = {.gain = 1, .limit = 1e9, .x = {0.5, 0}};
static int copies;

static int width(Reference r) { return FMI == 3 && (r == 4 || r == 6) ? 2 : 1; }

static int advance(void* c, double h) {
    char text[80];
    for (int k = 0; k < 2; k++) M.x[k] += M.gain * M.u[k] * h;
    M.time += h;
    M.count++;
    if (M.x[0] <= M.limit || ((Instance*)c)->chosen) return 3 * (M.x[0] > M.limit);
    sprintf(text, "x[1] = %g is above limit = %g", M.x[0], M.limit);
#if FMI == 2
    ((Instance*)c)->log->logger(((Instance*)c)->environment, "", 3, "logStatusError", "%s", text);
#else
    ((Instance*)c)->log(((Instance*)c)->environment, 3, "logStatusError", text);
#endif
    return 3;
}

static void* make(const char* token, Logger log, void* environment) {
    Instance* c = calloc(1, sizeof(Instance));
    c->model = FRESH;
    c->log = log;
    c->environment = environment;
    return strcmp(token, "{token}") ? 0 : c;
}

void F(FreeInstance, FreeInstance)(void* c) { free(c); }
int F(SetDebugLogging, SetDebugLogging)(void* c) { return !(((Instance*)c)->chosen = 1); }
int F(ExitInitializationMode, ExitInitializationMode)(void* c) { return 0; }
int F(Terminate, Terminate)(void* c) { return 0; }
int F(Reset, Reset)(void* c) { M = FRESH; return RESETS ? 0 : 3; }

int F(GetFMUstate, GetFMUState)(void* c, void** state) {
    *state = memcpy(malloc(sizeof(Model)), &M, sizeof(Model));
    copies++;
    return 0;
}
int F(SetFMUstate, SetFMUState)(void* c, void* state) { M = *(Model*)state; return 0; }
int F(FreeFMUstate, FreeFMUState)(void* c, void** state) {
    free(*state);
    *state = 0;
    copies--;
    return 0;
}

int F(GetReal, GetFloat64)(void* c, const Reference* r, size_t n, double* v COUNT) {
    for (size_t k = 0; k < n; k++)
        for (int e = 0; e < width(r[k]); e++) *v++ = (&M.time)[r[k] + e];
    return 0;
}
int F(SetReal, SetFloat64)(void* c, const Reference* r, size_t n, const double* v COUNT) {
    for (size_t k = 0; k < n; k++)
        for (int e = 0; e < width(r[k]); e++) (&M.time)[r[k] + e] = *v++;
    return 0;
}
int F(GetInteger, GetInt32)(void* c, const Reference* r, size_t n, int* v COUNT) {
    for (size_t k = 0; k < n; k++) v[k] = r[k] == 10 ? copies : M.count;
    return 0;
}
int F(GetBoolean, GetBoolean)(void* c, const Reference* r, size_t n, Boolean* v COUNT) {
    *v = M.on;
    return 0;
}
int F(SetBoolean, SetBoolean)(void* c, const Reference* r, size_t n, const Boolean* v COUNT) {
    M.on = *v;
    return 0;
}

#if FMI == 2
void* fmi2Instantiate(const char* name, int kind, const char* guid, const char* place, Logger log,
                      int visible, int logging) {
    return make(guid, log, log->componentEnvironment);
}
int fmi2SetupExperiment(void* c, int a, double tolerance, double start, int b, double stop) {
    M.time = start;
    return 0;
}
int fmi2EnterInitializationMode(void* c) { return 0; }
int fmi2DoStep(void* c, double t, double h, int last) {
    int status = advance(c, h);
    return status ? status : 2 * (M.count == M.last);
}
int fmi2GetBooleanStatus(void* c, int kind, int* value) {
    *value = kind == fmi2Terminated && M.count == M.last;
    return 0;
}
#else
void* fmi3InstantiateCoSimulation(
    const char* name, const char* token, const char* place, _Bool visible, _Bool logging,
    _Bool events, _Bool early, const Reference* r, size_t n, void* environment, Logger log,
    void* update) {
    return make(token, log, environment);
}
int fmi3EnterInitializationMode(void* c, _Bool a, double tolerance, double start, _Bool b,
                                double stop) {
    M.time = start;
    return 0;
}
int fmi3DoStep(void* c, double t, double h, _Bool none, _Bool* event, _Bool* ends, _Bool* early,
               double* reached) {
    int status = advance(c, h);
    *event = 0;
    *early = M.count == -M.last;
    *ends = M.count == M.last;
    *reached = *early ? t + 0.5 * h : M.time;
    return status;
}
#endif
"""


# name, reference, dimension, type, causality, start
VARIABLES = """gain 1 0 Real parameter 1
limit 2 0 Real parameter 1e9
last 3 0 Real parameter 0
u 4 2 Real input 0 0
on 8 0 Boolean input false
time 0 0 Real output
x 6 2 Real output 0.5 0
count 9 0 Integer output
was_on 8 0 Boolean output
copies 10 0 Integer local
label 11 0 String output"""
THREE = {"Real": "Float64", "Integer": "Int32"}  # what FMI 3 calls them


def description(version, interface):
    """modelDescription.xml, as far as fmpy reads it."""
    token, lines = "guid" if version == "2.0" else "instantiationToken", []
    for row in VARIABLES.splitlines():
        name, reference, dimension, kind, causality, *start = row.split()
        if kind == "String" and version == "3.0":
            continue
        more = f'causality="{causality}"' + ' initial="exact"' * (name == "x")
        if causality == "parameter":
            more += ' variability="fixed"'
        elif kind != "Real":
            more += ' variability="discrete"'
        if version == "3.0":
            given = f'start="{" ".join(start)}"' if start else ""
            inside = f'<Dimension start="{dimension}"/>' if dimension != "0" else ""
            tag, head = THREE.get(kind, kind), f'name="{name}" valueReference="{reference}" {more}'
            lines.append(f"<{tag} {head} {given}>{inside}</{tag}>")
            continue
        for k in range(max(1, int(dimension))):
            given = f'start="{start[k]}"' if start else ""
            element = f"{name}[{k + 1}]" if dimension != "0" else name
            head = f'name="{element}" valueReference="{int(reference) + k}" {more}'
            lines.append(f"<ScalarVariable {head}><{kind} {given}/></ScalarVariable>")
    return (
        f'<fmiModelDescription fmiVersion="{version}" modelName="integrators" {token}="{{token}}">'
        f'{interface}<LogCategories><Category name="logStatusError"/></LogCategories>'
        f"<ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )


def source(version):
    """A C file with every function that fmpy looks up; those that the model has not return 3."""
    header = HEADERS / f"fmi{version[0]}FunctionTypes.h"
    names = re.findall(r"(fmi\d\w+)TYPE *\(", header.read_text())
    own = {pair[version == "3.0"] for pair in re.findall(r"F\((\w+), (\w+)\)", MODEL)}
    left = [n for n in names if n not in MODEL and n[4:] not in own]
    return MODEL + "".join(f"int {n}() {{ return 3; }}\n" for n in left)


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """A function that makes the FMU, once for equal arguments: with state get and set (`keeps`),
    with a reset that works (`reset`), with a binary for this platform (`binary`)."""
    compiler, made = find_compiler(), {}
    if compiler is None:
        pytest.skip("needs a C compiler")

    def make(version="2.0", interface="CoSimulation", keeps=True, reset=True, binary=True):
        key = (version, interface, keeps, reset, binary)
        if key in made:
            return made[key]
        root = tmp_path_factory.mktemp("fmu")
        place = fmpy.platform if version == "2.0" else fmpy.platform_tuple
        folder = root / "unpacked" / "binaries" / (place if binary else "riscv64-plan9")
        folder.mkdir(parents=True)
        (root / "integrators.c").write_text(source(version))
        library = folder / f"integrators{fmpy.sharedLibraryExtension}"
        flags = ["-shared", "-fPIC", "-std=c99", "-w", f"-DFMI={version[0]}", f"-I{HEADERS}"]
        flags += [f"-DRESETS={int(reset)}", "-o", library, root / "integrators.c"]
        subprocess.run([*compiler, *flags], check=True)
        state = f'canGetAndSetFMU{"s" if version == "2.0" else "S"}tate="{str(keeps).lower()}"'
        state += ' canBeInstantiatedOnlyOncePerProcess="true"'
        xml = description(version, f'<{interface} modelIdentifier="integrators" {state}/>')
        (root / "unpacked" / "modelDescription.xml").write_text(xml)
        made[key] = root / "integrators.fmu"
        shutil.make_archive(str(root / "integrators"), "zip", root / "unpacked")
        (root / "integrators.zip").rename(made[key])
        return made[key]

    return make


def connected(system, u=U):
    """A Simulator of the system alone, its port `u` fixed."""
    simulator = Simulator(system)
    port = system.GetInputPort("u")
    port.FixValue(simulator.get_mutable_context(), np.resize([*u, 0.0], port.size()))
    simulator.Initialize()
    return simulator


def values(system, context, port="x"):
    return system.GetOutputPort(port).Eval(context)


def integrators(fmu, **options):
    """The system with ports `u` and `x` of two elements."""
    return FmuSystem(fmu, **{"step": STEP, "inputs": "u", "outputs": {"x": "x"}} | options)


# --- stepping ------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_elements_of_an_array_make_one_port_in_either_version(build, version):
    outputs = {"x": "x", "rest": ["count", "time"], "gain": "gain", "none": []}
    system = FmuSystem(build(version), step=STEP, inputs={"rate": "u"}, outputs=outputs)
    names = {"x": ("x[1]", "x[2]"), "rest": ("count", "time"), "gain": ("gain",)}
    assert (system.input_names, system.output_names) == ({"rate": ("u[1]", "u[2]")}, names)
    start = {"x[1]": 2.0} if version == "2.0" else {"x": np.array([2.0, 0.0])}
    system = integrators(build(version), start_values=start)
    # outputs have values before a simulation
    assert values(system, system.CreateDefaultContext()).tolist() == [2.0, 0.0]


@pytest.mark.parametrize("version", VERSIONS)
def test_outputs_are_the_models_values_at_each_step_and_held_between(build, version):
    system = FmuSystem(build(version), step=STEP, start_values={"gain": 3.0})
    assert system.input_names == {"u": ("u[1]", "u[2]", "on")}
    assert system.output_names == {"y": ("time", "x[1]", "x[2]", "count", "was_on")}
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("u").FixValue(context, [*U, 1.0])
    simulator.Initialize()
    assert values(system, context, "y").tolist() == [0, 0.5, 0, 0, 1]
    for k in range(1, 5):
        t = k * STEP
        simulator.AdvanceTo(t)
        assert values(system, context, "y").tolist() == [t, 0.5 + 3 * t, -6 * t, k, 1]
    simulator.AdvanceTo(t + 0.5 * STEP)  # has made the step that begins at t
    assert values(system, context, "y")[0] == t + STEP


@pytest.mark.parametrize("version", VERSIONS)
def test_an_fmu_starts_at_the_time_of_the_context_if_it_is_a_multiple_of_the_step(build, version):
    system = FmuSystem(build(version), step=0.1, outputs="time")
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    context.SetTime(0.3)
    simulator.Initialize()
    assert values(system, context, "y") == 0.3
    simulator.AdvanceTo(10.0)
    assert values(system, context, "y") == pytest.approx(10.0, abs=1e-12)
    context.SetTime(0.0)
    with pytest.raises(cs.ContactSystemError, match="time is 0 s and its FMU is at 10"):
        simulator.Initialize()
    for time in (0.05, -0.1, np.nan, np.inf):
        late = Simulator(FmuSystem(build(version), step=0.1))
        late.get_mutable_context().SetTime(time)
        with pytest.raises(cs.ContactSystemError, match=f"t = {time} s is not 0 or a positive"):
            late.Initialize()


def test_a_discrete_system_downstream_sees_the_sample_of_its_own_time(build):
    builder = DiagramBuilder()
    fmu = builder.AddSystem(integrators(build()))
    # x[n+1] = x[n] + STEP y[n], with y[n] = 0.5 + n STEP and -2 n STEP
    integral = builder.AddSystem(DiscreteTimeIntegrator(2, STEP))
    sink = builder.AddSystem(VectorLogSink(2, STEP))
    for system in (integral, sink):
        builder.Connect(fmu.get_output_port(), system.get_input_port())
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    fmu.get_input_port().FixValue(fmu.GetMyMutableContextFromRoot(root), U)
    simulator.AdvanceTo(4 * STEP)
    found = integral.get_output_port().Eval(integral.GetMyContextFromRoot(root))
    n = np.arange(4)
    y = np.array([0.5 + n * STEP, -2 * n * STEP])
    assert found.tolist() == (STEP * y.sum(axis=1)).tolist()
    log = sink.FindLog(root)
    assert np.vstack([log.sample_times(), log.data()])[:, :4].tolist() == [
        *map(list, (n * STEP, *y))
    ]


@pytest.mark.parametrize("version", VERSIONS)
def test_the_fmu_may_end_the_simulation(build, version):
    simulator = connected(integrators(build(version), start_values={"last": 6.0}))
    for _ in range(2):  # and does not go on when asked again
        status = simulator.AdvanceTo(10.0)
        assert "integrators asks to end here" in status.FormatMessage()
        assert simulator.get_context().get_time() <= 6 * STEP


# --- the Context holds the state -----------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_contexts_of_one_system_have_their_own_states_of_the_fmu(build, version):
    system = integrators(build(version))
    first = connected(system)
    first.AdvanceTo(2 * STEP)
    second = Simulator(system, first.get_context().Clone())
    system.GetInputPort("u").FixValue(second.get_mutable_context(), [0.0, 16.0])
    second.Initialize()
    for k in range(3, 6):
        for simulator in (first, second):
            simulator.AdvanceTo(k * STEP)
    assert values(system, first.get_context()).tolist() == [0.5 + 5 * STEP, -10 * STEP]
    assert values(system, second.get_context()).tolist() == [0.5 + 2 * STEP, 44 * STEP]


@pytest.mark.parametrize("version", VERSIONS)
def test_threads_that_share_an_fmu_take_turns(build, version):
    system = integrators(build(version))

    def run(speed):
        simulator = connected(system, [speed, -speed])
        simulator.AdvanceTo(200 * STEP)
        return values(system, simulator.get_context()).tolist()

    speeds = (1.0, 2.0, 3.0, 4.0)
    ends = [[0.5 + 200 * STEP * speed, -200 * STEP * speed] for speed in speeds]
    assert in_threads(run, speeds) == ends


@pytest.mark.parametrize("options", ({}, {"keeps": False}, {"keeps": False, "reset": False}))
@pytest.mark.parametrize("version", VERSIONS)
def test_a_simulation_can_be_run_again(build, version, options):
    system = integrators(build(version, **options), start_values={"gain": 2.0})
    for _ in range(3):
        simulator = connected(system)
        simulator.AdvanceTo(2 * STEP)
        assert values(system, simulator.get_context()).tolist() == [0.5 + 4 * STEP, -8 * STEP]
    simulator.AdvancePendingEvents()  # a Simulator of the Context's copy would do them again
    other = Simulator(system, simulator.get_context().Clone())
    if not options:
        other.AdvanceTo(4 * STEP)
        assert values(system, other.get_context()).tolist() == [0.5 + 8 * STEP, -16 * STEP]


@pytest.mark.parametrize("version", VERSIONS)
def test_without_state_get_and_set_a_second_context_is_refused(build, version):
    system = integrators(build(version, keeps=False))
    first = connected(system)
    first.AdvanceTo(2 * STEP)
    second = connected(system)  # has the FMU from here on
    second.AdvanceTo(STEP)
    message = r"cannot go to this Context's t = 0\.25 s: it is at t = 0\.125 s, and has no way back"
    with pytest.raises(cs.ContactSystemError, match=message):
        first.AdvanceTo(3 * STEP)
    saved = second.get_context().Clone()
    second.AdvanceTo(2 * STEP)
    assert values(system, second.get_context())[0] == 0.5 + 2 * STEP
    with pytest.raises(cs.ContactSystemError, match="make an FmuSystem for each Context"):
        Simulator(system, saved).AdvanceTo(2 * STEP)


# --- freeing -------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_a_systems_states_and_folder_are_freed_with_it(build, version, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(cs.ContactSystemError):
        FmuSystem(build(version), step=STEP, outputs="nothing")
    system = FmuSystem(build(version), step=STEP, outputs="copies")
    simulator = Simulator(system)
    simulator.AdvanceTo(100 * STEP)
    assert values(system, simulator.get_context(), "y") <= 4  # of 100 steps' states
    gc.collect()
    assert len(list(tmp_path.iterdir())) == 1
    gone = weakref.ref(system)
    context = simulator.get_context().Clone()  # outlives the system
    del system, simulator
    gc.collect()
    assert gone() is None and context is not None
    assert not list(tmp_path.iterdir())
    two = [FmuSystem(build(version).parent / "unpacked", step=1, outputs="copies") for _ in "ab"]
    assert [values(x, x.CreateDefaultContext(), "y")[0] for x in two] == [0, 0]  # not of one file


# --- refusals ------------------------------------------------------------------------------------


def test_an_unknown_variable_is_refused_with_the_nearest(build):
    for options, message in (
        ({"inputs": "u[3]"}, r"no numeric input variable 'u\[3\]' \(did you mean 'u\[[12]\]'"),
        ({"outputs": {"y": ["cuont"]}}, "no numeric output variable 'cuont' .did you mean 'count"),
        ({"start_values": {"gian": 1.0}}, "no variable 'gian' .did you mean 'gain"),
        ({"inputs": "x[1]"}, r"no numeric input variable 'x\[1\]'"),
        ({"outputs": "label"}, "no numeric output variable 'label'"),
        ({"start_values": {"count": 1}}, "count cannot be set at the start"),
        ({"start_values": {"on": 2}}, "on = 2, is not of type Boolean"),
        ({"start_values": {"gain": [1, 2]}}, r"gain = \[1, 2\]: give 1 of type Real"),
        ({"start_values": {"gain": "high"}}, "initialization failed .*'high'"),
    ):
        with pytest.raises(cs.ContactSystemError, match=f"^integrators.*{message}"):
            FmuSystem(build(), **{"step": STEP} | options)


def test_fmus_without_co_simulation_or_a_binary_for_this_platform_are_refused(build, tmp_path):
    (tmp_path / "no.fmu").write_text("no zip")
    for fmu, message in (
        (build(interface="ModelExchange"), "no co-simulation interface"),
        (build(binary=False), "platforms that it has: riscv64-plan9; export it again"),
        (build("3.0", binary=False), f"no binaries/{fmpy.platform_tuple}/integrators"),
        (tmp_path / "missing.fmu", "missing.fmu cannot be read"),
        (tmp_path / "no.fmu", "no.fmu: not an FMU"),
        (tmp_path, "modelDescription.xml"),
    ):
        with pytest.raises(cs.ContactSystemError, match=message):
            FmuSystem(fmu, step=STEP)
    with pytest.raises(cs.ContactSystemError, match="step = 0.0: give a finite number"):
        FmuSystem(build(), step=0.0)


def changed_fmu(good, path, old="", new="", **members):
    """A copy of an FMU with a text of its description replaced, and members replaced or added."""
    with zipfile.ZipFile(good) as archive:
        kept = {m: archive.read(m) for m in archive.namelist() if not m.endswith("/")}
    library = next(name for name in kept if "binaries/" in name)
    kept["modelDescription.xml"] = kept["modelDescription.xml"].replace(old.encode(), new.encode())
    kept |= {library if name == "library" else name: data for name, data in members.items()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in kept.items():
            archive.writestr(name, data)
    return path


def test_a_damaged_fmu_is_refused_and_writes_nothing_outside_its_folder(
    build, tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # where FMUs are unpacked
    for change, message in (
        ({"old": "<ModelVariables>", "new": "<a>" * 10**5}, "is not one of FMI 2 or 3"),
        ({"../x": b"", "library": b"text"}, "failed at t = 0 s"),
    ):
        path = changed_fmu(build("3.0"), tmp_path / "strange.fmu", **change)
        with pytest.raises(cs.ContactSystemError, match=f"strange.fmu.*{message}"):
            FmuSystem(path, step=STEP)
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("version", VERSIONS)
def test_the_error_of_a_failing_step_has_the_fmus_own_message(build, version):
    system = integrators(build(version), start_values={"limit": 0.7}, instance_name="tank")
    simulator = connected(system)
    message = r"^tank: a step of 0\.125 s failed at t = 0\.125 s: .*\(error\).* It says: x\[1\] = "
    for _ in range(2):  # the second time from the state before the step that failed
        simulator.Initialize()
        with pytest.raises(cs.ContactSystemError, match=message + r"0\.75 is above limit = 0\.7$"):
            simulator.AdvanceTo(10.0)
    simulator = connected(system)  # the system can be used again
    simulator.AdvanceTo(STEP)
    assert values(system, simulator.get_context())[0] == 0.5 + STEP
    if version == "3.0":  # an early return is an error, unless the FMU asks to end the simulation
        system = integrators(build(version), start_values={"last": -2.0}, instance_name="tank")
        words = r"^tank: a step of 0\.125 s failed at t = 0\.125 s: fmi3DoStep, early return"
        with pytest.raises(cs.ContactSystemError, match=words):
            connected(system).AdvanceTo(10.0)


@pytest.mark.parametrize("version", VERSIONS)
def test_inputs_that_are_nan_or_not_boolean_are_refused_by_name(build, version):
    system = FmuSystem(build(version), step=STEP)
    simulator = Simulator(system)
    for u, message in (
        ([0.0, np.nan, 0.0], r"element 1, u\[2\] = nan, is not a number"),
        ([0.0, 0.0, 0.5], "element 2, on = 0.5, is not of type Boolean"),
    ):
        system.GetInputPort("u").FixValue(simulator.get_mutable_context(), u)
        with pytest.raises(cs.ContactSystemError, match="input port 'u' at t = 0 s: " + message):
            simulator.Initialize()


def test_fmpy_still_logs_messages_of_other_fmus_after_a_system_is_gone(tmp_path, capfd):
    file = export_fmu(cs.load_scene("K2"), tmp_path / "K2.fmu", fmi_version="2.0")
    FmuSystem(file, step=0.1)
    gc.collect()
    with pytest.raises(fmpy.fmi1.FMICallException):
        fmpy.simulate_fmu(str(file), start_values={"object.radius": -1.0}, debug_logging=True)
    assert "object.radius = -1 is refused" in capfd.readouterr().out


# --- the planner ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [np.array, list])
def test_the_start_value_of_a_matrix_is_given_as_a_matrix(kind, tmp_path):
    given = {"fmi_version": "3.0", "arrays": True, "measured": "pose"}
    file = export_fmu(cs.load_scene("K2"), tmp_path / "K2.fmu", **given)
    name, rotation = "contact[1].measured.pose.rotation", [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    system = FmuSystem(file, step=0.1, outputs=name, start_values={name: kind(rotation)})
    assert values(system, system.CreateDefaultContext(), "y").tolist() == sum(rotation, [])


@pytest.mark.parametrize("version", VERSIONS)
def test_a_planner_whose_path_has_ended_says_so(version, tmp_path):
    scene = cs.load_scene("K1").replace(profile=cs.Profile([0.3, -0.3]))
    simulator = Simulator(FmuSystem(export_fmu(scene, tmp_path / "K1.fmu", version), step=0.3))
    with pytest.raises(cs.ContactSystemError, match=r"t = 0\.9 s: .*sigma is negative from"):
        simulator.AdvanceTo(2.0)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A scene whose window's edges lie between steps, and its FMU of each version."""
    scene = cs.load_scene("D1")
    scene = scene.replace(
        disturbances=[cs.FingerAcceleration(0, 0.1013, 0.1577, (-50.0, 30.0))], duration=0.5
    )
    folder = tmp_path_factory.mktemp("planner")
    return scene, {v: export_fmu(scene, folder / f"planner{v}.fmu", v) for v in VERSIONS}


@pytest.mark.parametrize("disturbed", (False, True))
@pytest.mark.parametrize("version", VERSIONS)
def test_the_exported_planner_moves_as_the_planner_in_the_same_diagram(
    exported, version, disturbed
):
    scene, files = exported
    step, builder = 0.01, DiagramBuilder()
    planner = builder.AddSystem(ContactPlanner(scene, disturbance_input=disturbed))
    slip = [f"contact[{i + 1}].slip" for i in range(3)]
    outputs = {"state": [name for i in range(3) for name in columns(i)], "slip": slip}
    fmu = builder.AddSystem(FmuSystem(files[version], step=step, outputs=outputs))
    if disturbed:  # an FMU samples its inputs itself
        source = builder.AddSystem(Sine(np.full(18, 0.5), np.full(18, 40.0), np.arange(18.0)))
        hold = builder.AddSystem(ZeroOrderHold(step, 18))
        builder.Connect(source.get_output_port(0), hold.get_input_port())
        builder.Connect(source.get_output_port(0), fmu.get_input_port())
        builder.Connect(hold.get_output_port(), planner.get_input_port())
    logs = {}
    for port in outputs:
        for system in (planner, fmu):
            logs[port, system] = builder.AddSystem(VectorLogSink(6 if port == "slip" else 27, step))
            builder.Connect(system.GetOutputPort(port), logs[port, system].get_input_port())
    simulator = Simulator(builder.Build())
    ResetIntegratorFromFlags(simulator, "runge_kutta5", 2e-4)
    simulator.get_mutable_integrator().set_fixed_step_mode(True)
    simulator.AdvanceTo(0.2)
    for port in outputs:
        planned, found = (
            logs[port, system].FindLog(simulator.get_context()).data() for system in (planner, fmu)
        )
        assert found.shape[1] >= 20
        first = int(disturbed)  # at t = 0 s the hold has not sampled yet
        assert np.abs(found - planned)[:, first:].max() <= 1e-9


def test_without_fmpy_importing_fmu_system_says_what_to_install_and_the_rest_works(monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    monkeypatch.delitem(sys.modules, "drake_plant.fmu_system")
    with pytest.raises(ImportError, match=re.escape('pip install "contact-system[fmu]"')):
        importlib.import_module("drake_plant.fmu_system")
    names: dict = {}
    exec("from drake_plant import *", names)
    assert "BuildStation" in names and "FmuSystem" not in names
