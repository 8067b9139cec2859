"""Contribution of supplied poses to the proof."""

from typing import Final

from planner.processes.poses.proof.rules import given_poses
from planner.proof.contribution import ProofOfProcess

PROOF: Final = ProofOfProcess(rules=(given_poses.follows,))
