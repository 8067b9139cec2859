"""The proof, from the problem and the programs' own text; docs/proof.md lists what it shares."""
