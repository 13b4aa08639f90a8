"""By what the faces of a photograph, their landmarks and heads are chosen."""

from typing import Literal

LandmarkerName = Literal["mediapipe", "dlib"]
WhichFaces = int | Literal["all"]  # counted from 1, the largest
HeadName = Literal["fitted", "deformed"]
