"""Names of dictionaries and of constraints on weights, which the command line takes as choices.

They stand by themselves so that parsing a command imports no torch.
"""

from typing import Literal

# Dictionaries that come with the package: skylight.csc._dictionary
BuiltinName = Literal["iso", "ani", "vmf", "box"]
# Weights of either sign with a weak L1 norm, none below 0, or plain least squares
Sign = Literal["l1", "nonnegative", "free"]
