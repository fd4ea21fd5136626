"""Wrong decoders, each with one line of meaning changed, and what the vectors make of them."""

from __future__ import annotations

from conformance.mutants.fingerprint import fingerprints as fingerprints
from conformance.mutants.library import MUTANTS as MUTANTS
from conformance.mutants.mutant import Mutant as Mutant
from conformance.mutants.mutant import load as load
from conformance.mutants.trial import outcome as outcome

__all__ = ["MUTANTS", "Mutant", "fingerprints", "load", "outcome"]
