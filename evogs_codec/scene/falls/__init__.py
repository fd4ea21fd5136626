"""No prefix looks worse than a shorter one: what falls is found, and made otherwise.

`steady` is what an encode calls. It looks at the states after each step of the levels (`states`),
then at the prefixes that end with a packet (`packet_looks`); `packet_falls` says what is tried
there, of which one is another order of some packets (`order_by_views`).
"""
