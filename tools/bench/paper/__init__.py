"""The comparison of the paper, remade on any data set from runs of the queue."""
