"""From trees to streams: quantisation, rate and distortion, the order of packets."""
