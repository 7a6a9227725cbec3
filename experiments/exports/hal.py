"""A component of LinuxCNC's hardware abstraction layer, for halcompile."""

from collections.abc import Mapping

from experiments.exports.c99 import c_code
from experiments.exports.program import ExportError, Program
from experiments.exports.replay import Replay
from experiments.exports.templates import rendered
from experiments.reports.report import version_of

LONGEST_PIN = 47  # letters of a name in HAL
# LinuxCNC 2.9's own, which `halcompile --install` would replace without a word
COMPONENTS = """abs abs_s32 and2 anglejog axistest bin2gray biquad bitslice bitwise bldc blend boss_plc carousel
charge_pump clarke2 clarke3 clarkeinv classicladder_rt comp constant conv_bit_float conv_bit_s32 conv_bit_u32
conv_float_s32 conv_float_u32 conv_s32_bit conv_s32_float conv_s32_u32 conv_u32_bit conv_u32_float conv_u32_s32
corexy_by_hal corexykins counter dbounce ddt deadzone debounce demux differential div2 edge encoder encoder_ratio
eoffset_per_angle estop_latch feedcomp filter_kalman flipflop gantry gearchange genhexkins genserkins gray2bin
hal_bb_gpio hal_gm hal_lib hal_parport hal_pi_gpio hal_ppmc hal_speaker histobins hm2_7i43 hm2_7i90 hm2_eth hm2_pci
hm2_rpspi hm2_spi hm2_test homecomp homemod hostmot2 hypot ilowpass integ invert joyhandle knob2float latencybins lcd
limit1 limit2 limit3 lincurve lineardeltakins logic lowpass lut5 maj3 match8 matrix_kb max31855 maxkins mesa_7i65
mesa_pktgyro_test mesa_uart message millturn minmax modmath motmod moveoff mult2 multiclick multiswitch mux16 mux2 mux4
mux8 mux_generic near not offset ohmic oneshot or2 orient pentakins pid plasmac pumakins pwmgen rosekins
rotarydeltakins rotatekins sample_hold sampler scale scaled_s32_sums scarakins scope_rt scorbot_kins select8 serport
setsserial siggen sim_axis_hardware sim_encoder sim_home_switch sim_matrix_kb sim_parport sim_spindle simple_tp
sphereprobe spindle spindle_monitor stepgen steptest streamer sum2 supply thc thcud threads threadtest time timedelay
timedelta tof toggle toggle2nist ton tp tpmod tripodkins tristate_bit tristate_float trivkins updown userkins watchdog
wcomp weighted_sum xhc_hb04_util xor2 xyzab_tdr_kins xyzac_trt_kins xyzbc_trt_kins"""


def hal_files(program: Program, title: str, replay: Replay, tolerances: Mapping[str, float]) -> Mapping[str, str]:
    """The files by their names: the component, its code, the types of that, and the bench with its run."""
    if program.name.lower() in COMPONENTS.split():
        raise ExportError(
            f"name {program.name}: LinuxCNC has a component of this name, which yours would replace; choose another by "
            "--name"
        )
    names = [one.name for one in program.parameters] + [one.name for one in program.inputs]
    longest = max(names, key=len)
    most = LONGEST_PIN - len(f".0.{longest}")
    if len(program.name) > most:
        raise ExportError(
            f"name {program.name}: names in HAL are short, and it may have {most} letters beside {longest}"
        )
    values = {"code": c_code(program), "program": program, "title": title, "version": version_of("diffdrive")}
    templates = {
        f"{program.name}.comp": "hal.comp.jinja",
        f"{program.name}_hal.h": "hal.h.jinja",
        f"{program.name}.h": "c99.h.jinja",
        f"{program.name}_hal_bench.py": "hal_bench.py.jinja",
    }
    files = {file: rendered(template, tolerances=tolerances, **values) for file, template in templates.items()}
    return files | {f"{program.name}_run.csv": replay.as_csv()}
