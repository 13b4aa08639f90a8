"""The photographs to try: which there are, and the files of them."""

from io import BytesIO

import httpx
import numpy as np
from PIL import Image

from skylight.estimation._examples import EXAMPLES


def test_they_are_those_of_the_demonstration(client: httpx.Client) -> None:
    told = client.get("/api/examples").json()
    assert [each["name"] for each in told] == [example.name for example in EXAMPLES]
    assert [each["expected"] for each in told] == [example.expected for example in EXAMPLES]
    for each, example in zip(told, EXAMPLES, strict=True):
        assert each["credit"] == f"{example.author}, {example.licence}"
        answer = client.get(f"/api/examples/{each['name']}.png")
        assert answer.headers["content-type"] == "image/png"
        with Image.open(BytesIO(answer.content), formats=["PNG"]) as picture:
            assert np.array_equal(np.asarray(picture), example.codes())
