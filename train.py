"""python train.py CONFIG [KEY=VALUE ...]: run one of the configurations; --help lists them."""

from skylight.training._run import main

if __name__ == "__main__":
    main()
