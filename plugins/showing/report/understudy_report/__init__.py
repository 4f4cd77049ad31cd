"""A run's report page, its motion as a video, and its metrics for TensorBoard."""

#: Plugins that this one builds on.
REQUIRES = ("motion",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "observer": {
        "progress": ("progress:ProgressLine", "a line of progress"),
        "tensorboard": ("tensorboard:TensorBoard", "metrics for TensorBoard"),
        "report": ("maker:ReportMaker", "report page, pictures and video"),
    },
    "command": {
        "runs": ("listing:ListRuns", "list runs, newest first, with their results"),
    },
    "report_section": {
        "headline": ("headline:Headline", "the result in a sentence, and the figures to remember"),
        "motion": ("motion:Motion", "the video or a stick figure player, and a filmstrip"),
        "evaluation": ("evaluation:EvaluationSection", "what the last evaluation found"),
        "learning": ("learning:LearningCurves", "metrics against samples"),
        "model_error": ("model_error:ModelError", "where a learned model goes wrong"),
        "provenance": ("provenance:Provenance", "what is needed to repeat the run, whom to credit"),
        "configuration": ("configuration:Configuration", "the composed configuration"),
    },
}

#: Kinds of parts that this one adds, and what each is.
KINDS = {"report_section": "a part of a run's report page"}
