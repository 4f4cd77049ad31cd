"""Motion clips: reading, checking, sampling. Nothing here knows a particular character."""

from understudy import hookimpl
from understudy.setup.registry import Registrar

#: Plugins that this one builds on.
REQUIRES = ("tensors",)


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.kind("clip", "a generated motion clip")
    register.kind("clip_reader", "reads a format of motion clips")
    register.kind("clip_writer", "writes a format of motion clips")
    add, here = register.component, "understudy_motion"
    add("clip_reader", "amc", f"{here}.readers.amc:AmcReader", "Acclaim: AMC on its ASF")
    add("clip_reader", "angles", f"{here}.readers.angles:AnglesReader", "a robot's table of angles")
    add("clip_reader", "bvh", f"{here}.readers.bvh:BvhReader", "Biovision hierarchy")
    add("clip_reader", "csv", f"{here}.readers.table:CsvReader", "a table of named columns")
    add("clip_reader", "deepmimic", f"{here}.readers.deepmimic:DeepMimicReader", "DeepMimic's JSON")
    add("clip_reader", "npz", f"{here}.readers.table:NpzReader", "everything a clip has")
    add("clip_reader", "smpl", f"{here}.readers.smpl:SmplReader", "AMASS, SMPL, SMPL-H and SMPL-X")
    add("clip_writer", "bvh", f"{here}.writers.bvh:BvhWriter", "Biovision hierarchy")
    add("clip_writer", "csv", f"{here}.writers.table:CsvWriter", "a table of named columns")
    add("clip_writer", "npz", f"{here}.writers.table:NpzWriter", "everything a clip has")
    add("command", "motion fetch", f"{here}.fetch.command:Fetch", "fetch clips with their licence")
    register.section(
        "motion", "understudy_motion.section:MotionOptions", "understudy_motion.section:Motion"
    )
