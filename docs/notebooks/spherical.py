# %% [markdown]
# # A spherical robot and one camera
#
# DIAMOND turns a tool about a fixed centre; a camera sees a marker on the tool, in pixels. Its joints start elsewhere
# than the drawing says, and its limbs differ.

# %%
import sherkit as sk

study = sk.Study("spherical.toml", "spherical.csv")
study.robot

# %%
found = study.diagnose()
found

# %% [markdown]
# What is named is added, one after the other:

# %%
for name in found.effects:
    study.add(name)
study

# %%
study.fit
