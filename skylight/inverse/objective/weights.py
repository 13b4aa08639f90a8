"""How much the parts of the objective count."""

from dataclasses import dataclass

# Automatic white balance misses the light's colour by 2 to 5 degrees in the mean, as the angle
# between colours (Gijsenij, Gevers & van de Weijer 2011, "Computational color constancy: survey and
# experiments", IEEE Trans. Image Processing 20(9); Cheng, Prasad & Brown 2014, JOSA A 31(5)). White
# turns by 2/3 of this spread, rms: 3.8 degrees.
WHITE_BALANCE_SPREAD = 0.1


@dataclass(frozen=True, kw_only=True)
class ObjectiveWeights:
    """How much the parts count. All parts are negative log-likelihoods, in nats.

    ``noise`` is the expected mean deviation of a pixel from the model, relative to the face's
    mean radiance: not sensor noise, but freckles, gloss and wrong geometry. Neighbouring pixels
    deviate together, so a face's pixels count as ``independent`` observations, whatever their
    number; those of several faces add up.

    ``white_balance_spread`` is the standard deviation of the log of red and of blue against green
    that a camera leaves in a picture of something grey; 0 trusts its white balance.
    ``pigment_spread`` multiplies :data:`skylight.faces.skin.PIGMENT_SPREADS`, by which skin
    varies over a face; 0 gives a face one albedo.

    ``normal_spread`` multiplies the standard deviations of a head's normal errors
    (:mod:`skylight.faces.normal_errors`); 0 trusts the fitted head. It is less than 1 for the
    reason that follows: against data that count for too much, priors must too.

    ``sun_prior`` weighs what clock and place tell of the sun against the face as the posterior
    does, whose temperature (:class:`~skylight.inverse.posterior.PosteriorConstants`) was fitted to
    known suns: ``independent / noise`` times that. Heads are fitted wrongly all over, so what a
    face says of the sun's place is not as sure as so many independent pixels would make it.
    """

    noise: float = 0.06
    independent: float = 250.0
    light_prior: float = 1.0
    albedo_prior: float = 1.0
    ground_prior: float = 1.0
    white_balance_spread: float = WHITE_BALANCE_SPREAD
    pigment_spread: float = 0.0
    normal_spread: float = 0.7
    sun_prior: float = 112.0
