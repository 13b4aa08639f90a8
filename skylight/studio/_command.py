"""``skylight studio``: the local web application."""

from pathlib import Path


def studio(
    host: str = "127.0.0.1",
    port: int = 8600,
    no_browser: bool = False,
    upload_mb: float = 50.0,
    upload_s: float = 600.0,
    megapixels: float = 50.0,
    jobs: int = 4,
    model: Path | None = None,
    network: str | None = None,
) -> None:
    """Open a page in the browser that finds light in photos and shows it; Ctrl-C ends it.

    Everything stays on this machine. Photos and results are forgotten when you close them, or
    when it ends: download what you want to keep.

    Args:
        host: Address to listen at; 0.0.0.0 lets other machines in, which nothing else protects.
        port: Port to listen at; 0 takes one that is free.
        no_browser: Only say where the page is.
        upload_mb: Largest file that it takes.
        upload_s: Longest time in seconds that a file may take to come in.
        megapixels: Largest picture that it takes; reading it takes 32 MB of memory a megapixel.
        jobs: Most jobs that may wait or run.
        model: Folder of a trained model of your own to estimate with.
        network: Class of that model's network, where it is yours, as module:Class.
    """
    from skylight.studio._guard import Limits
    from skylight.studio._server import serve

    limits = Limits(upload_mb=upload_mb, upload_s=upload_s, megapixels=megapixels, jobs=jobs)
    serve(host=host, port=port, browser=not no_browser, limits=limits, model=model, network=network)
