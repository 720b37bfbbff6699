# %% [markdown]
# # A flexible tool: depth and tip
#
# A needle that bends where the sclera pushes it. Gratings in its shaft feel the force, a camera sees the tip.

# %%
import sherkit as sk
from sherkit.robots.tool.filters import estimate
from sherkit.robots.tool.model import ToolModel
from sherkit.robots.tool.runs import read_tool_run
from sherkit.robots.tool.tool import load_tool

tool, run = load_tool("tool.toml"), read_tool_run("tool.csv")
estimate(tool, run)

# %% [markdown]
# Against the camera: what is missing?

# %%
model = ToolModel(tool, run)
found = sk.diagnose(sk.identify(model, model.readings))
found
