from ._printing import (
    PrintedPartitions as PrintedPartitions,
    print_partition_probe as print_partition_probe,
)
from ._solids import (
    ProbeSizes as ProbeSizes,
)
