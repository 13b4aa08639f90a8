"""python train.py configs/NAME.yaml [--key value ...]: run one of the configurations."""

from skylight.training._run import main

if __name__ == "__main__":
    main()
