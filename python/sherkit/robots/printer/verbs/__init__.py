"""Its verbs, in their places in the help; each is loaded when it is called."""

from ....cli.groups import Later

PRINTER = Later(
    "sherkit.robots.printer.verbs.printer:printer",
    "Printer",
    "what is wrong with a delta printer, by what it probed",
    "sherkit printer printer.cfg --report printer.html",
    "sherkit printer printer.cfg --plate turned=60 -o new.cfg",
)
