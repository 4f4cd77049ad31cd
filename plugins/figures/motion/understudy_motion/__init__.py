"""Motion clips: reading, checking, sampling. Nothing here knows a particular character."""

#: Plugins that this one builds on.
REQUIRES = ("tensors",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "clip_reader": {
        "amc": ("readers.amc:AmcReader", "Acclaim: AMC on its ASF"),
        "angles": ("readers.angles:AnglesReader", "a robot's table of angles"),
        "bvh": ("readers.bvh:BvhReader", "Biovision hierarchy"),
        "csv": ("readers.table:CsvReader", "a table of named columns"),
        "deepmimic": ("readers.deepmimic:DeepMimicReader", "DeepMimic's JSON"),
        "npz": ("readers.table:NpzReader", "everything a clip has"),
        "robot_npz": ("readers.robot_npz:RobotNpzReader", "a robot's root and angles in an NPZ"),
        "smpl": ("readers.smpl:SmplReader", "AMASS, SMPL, SMPL-H and SMPL-X"),
    },
    "clip_writer": {
        "bvh": ("writers.bvh:BvhWriter", "Biovision hierarchy"),
        "csv": ("writers.table:CsvWriter", "a table of named columns"),
        "npz": ("writers.table:NpzWriter", "everything a clip has"),
    },
    "command": {
        "motion fetch": ("fetch.command:Fetch", "fetch clips with their licence"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {
    "clip": "a generated motion clip",
    "clip_reader": "reads a format of motion clips",
    "clip_writer": "writes a format of motion clips",
}

#: Sections of a configuration: the options, and what is built of them.
SECTIONS = {"motion": ("section:MotionOptions", "section:Motion")}
