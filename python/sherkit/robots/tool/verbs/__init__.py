"""Its verbs, in their places in the help; each is loaded when it is called."""

from ....cli.groups import Later

TOOL = Later(
    "sherkit.robots.tool.verbs.story:tool_story",
    "Flexible tool",
    "a tool file from known loads, its story in a run",
    "sherkit tool bench.csv free.csv run.csv -o tool.toml --report tool.html",
    at=1,
)
ESTIMATE = Later(
    "sherkit.robots.tool.verbs.estimate:estimate",
    "Flexible tool",
    "depth and tip of a tool along a run",
    "sherkit estimate tool.toml run.csv -o estimate.csv",
    at=2,
)
REGISTER = Later(
    "sherkit.robots.tool.verbs.register:register",
    "Flexible tool",
    "frame and clock of its camera",
    "sherkit register tool.toml camera.csv -o registered.toml",
    at=3,
)
