"""`evogs bench paper`: the paper's comparison, remade on any data set from runs of the queue."""
