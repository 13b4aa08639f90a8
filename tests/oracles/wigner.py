"""Wigner's small d matrix by his own sum, in exact arithmetic: slow and independent."""

import math
from fractions import Fraction


def small_d(l: int, m: int, n: int, beta: float) -> float:  # noqa: E741
    """``d^l_mn(beta) = <l m| exp(-i beta J_y) |l n>``, with the Condon-Shortley sign.

    The alternating sum is of integers and loses nothing; only cos and sin of beta / 2 and the last
    root are rounded. (Wigner 1931; Varshalovich et al. 1988, 4.3.1, eq. 2.)
    """
    cosine, sine = Fraction(math.cos(beta / 2)), Fraction(math.sin(beta / 2))
    factorial = math.factorial
    total = Fraction(0)
    for k in range(max(0, n - m), min(l + n, l - m) + 1):
        below = factorial(l + n - k) * factorial(k) * factorial(m - n + k) * factorial(l - m - k)
        term = cosine ** (2 * l + n - m - 2 * k) * sine ** (m - n + 2 * k)
        total += (-1) ** (m - n + k) * term / below
    product = factorial(l + m) * factorial(l - m) * factorial(l + n) * factorial(l - n)
    # the root of a fraction, so that neither factor leaves the range of floats
    square = total * total * product
    return math.copysign(math.sqrt(square), total) if total else 0.0
