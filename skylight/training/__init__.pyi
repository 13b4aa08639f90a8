from ._autoencoder import (
    reconstruction_loss as reconstruction_loss,
    train as train,
)
from ._callbacks import (
    Callback as Callback,
    Epoch as Epoch,
    Run as Run,
    TensorBoard as TensorBoard,
)
from ._config import (
    AutoencoderConfig as AutoencoderConfig,
    DictionaryConfig as DictionaryConfig,
    PriorConfig as PriorConfig,
    find_config as find_config,
    read_config as read_config,
)
from ._dictionary import (
    learn_dictionary as learn_dictionary,
)
from ._prior import (
    best_mixture as best_mixture,
    fit_priors as fit_priors,
)
from ._skies import (
    Corruption as Corruption,
    SkyData as SkyData,
    load_data as load_data,
)
