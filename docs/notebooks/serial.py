# %% [markdown]
# # A serial arm and a tracker
#
# Six joints, a target on the flange, a tracker that stands anywhere. Each joint gives way a little under the weight of
# what it carries.

# %%
import sherkit as sk

study = sk.Study("serial.toml", "serial.csv")
study.robot

# %%
found = study.diagnose()
found

# %%
for name in found.effects:
    study.add(name)
study

# %%
study.calibration()
