"""Random and damaged streams, on which the codec and the oracle must agree."""
