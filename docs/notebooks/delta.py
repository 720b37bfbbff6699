# %% [markdown]
# # A linear delta: which effect is missing?
#
# The drawing of a retinal-surgery stage, and readings of its platform by three lasers. The rails of this one lean; what
# follows does not know that.

# %%
import sherkit as sk

study = sk.Study("delta.toml", "delta.csv")
study.robot

# %% [markdown]
# What the twelve geometric parameters leave, and what that looks like:

# %%
found = study.diagnose()
found

# %% [markdown]
# What is it that was named?

# %%
study.model.known_effects[found.effects[0]]

# %% [markdown]
# With it in the model the error falls, at places that were not fitted:

# %%
study.add(found.effects[0])
study

# %% [markdown]
# What goes into the control loop, and how well it will do there:

# %%
made = study.calibration()
made

# %%
print(made.inverse([5.0, -3.0, 2.0]), "mm at the rails;", f"within {1e3 * made.accuracy([5.0, -3.0, 2.0]):.1f} µm")
