"""Names of the package: each class means one thing, and words that the field has another name for do not come back."""

from __future__ import annotations

import ast
from collections import Counter

from sources import nodes
from test_floors import PACKAGE

#: Names that were, and what the field says: the list may grow, not shrink.
GONE = {
    "as_annotated": "validate_arguments", "as_near": "equivalent_models", "beside_one_another": "column_slices",
    "brought_beside": "plugins", "by_noise_alone": "noise_quantile", "can_be_tried": "is_testable",
    "crowded": "overparametrised", "few_enough": "backward_elimination", "is_silent": "effects_excluded",
    "Doubt": "DataWarning", "FewEnough": "Elimination", "Judgement": "ErrorStatistics", "Knowledge": "NeesConsistency",
    "Look": "InterimAnalysis", "Moved": "ParameterChange", "OfEffects": "EffectColumns", "OfModel": "ModelColumns",
    "Part": "IdentifiedModel", "SeenRun": "RunData", "Stand": "RunPose", "Tried": "CandidateColumns",
    "UnobservedEffect": "BiasBound", "Wrong": "Problem",
}  # fmt: skip
#: The same of files.
FILES_GONE = {
    "answers": "result", "checked": "checks", "doors": "lazy_imports", "examined": "printer_diagnosis",
    "joined": "pooled_fit", "named": "selection", "own": "user_driver", "part": "identified_model", "shown": "views",
    "stand": "run_pose", "stories": "pages", "suspects": "hypotheses",
}  # fmt: skip


def test_the_name_of_a_class_means_one_thing() -> None:
    """Catches a second class of a name: who reads `Rows` would have to know which of three it is."""
    names = Counter(
        node.name for file in PACKAGE.rglob("*.py") for node in nodes(file) if isinstance(node, ast.ClassDef)
    )
    assert not [name for name, count in names.items() if count > 1]


def test_words_that_the_field_has_another_name_for_do_not_come_back() -> None:
    """Catches a name of the house's own beside that of the field."""
    wrong = []
    for file in sorted(PACKAGE.rglob("*.py")):
        if file.stem in FILES_GONE:
            wrong.append(f"{file.relative_to(PACKAGE)}: call it {FILES_GONE[file.stem]}.py")
        for node in nodes(file):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name in GONE:
                wrong.append(f"{file.relative_to(PACKAGE)}:{node.lineno} {node.name}: call it {GONE[node.name]}")
    assert not wrong, "\n".join(wrong)
