"""Which rules prove which kind of claim. Nothing may be claimed that no rule looks at, for a reader of the
claims would take it as proven."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from planner import claims, claims_dialogue, claims_forming, claims_milling
from planner.claims import Claim, OneOf
from planner.issues import Issue

PROVEN_BY: Final[Mapping[type, tuple[str, ...]]] = {
    claims.WireJoins: ("verify.wire_length", "verify.wire_stability", "verify.curvature"),
    claims.StraightWire: ("verify.bow",),
    claims.CutsSurface: ("verify.surface", "verify.part"),
    claims.FollowsRulings: ("verify.rulings",),
    claims.KerfWithin: ("verify.kerf",),
    claims.SlitsAllowed: ("verify.part", "verify.slit"),
    claims.LeadsFrom: ("verify.slit",),
    claims.HoldsStock: ("verify.load", "verify.held_frame"),
    claims.ContactOnlyIn: ("verify.contact", "verify.wire_power", "verify.spindle"),
    claims.OneOf: ("verify.dialogue",),
    claims_dialogue.OperatorDialogue: ("verify.dialogue", "verify.dialogue_figures"),
    claims.FeedWindow: ("verify.feed", "verify.order", "verify.mill_feed"),
    claims.FollowsPoses: ("verify.follows",),
    claims.FollowsTable: ("verify.follows",),
    claims_forming.FormsSheet: ("verify.gouge", "verify.formed"),
    claims_forming.ToolGap: ("verify.gap",),
    claims_forming.SupportsBorder: ("verify.border",),
    claims_forming.FollowsOpposite: ("verify.opposite",),
    claims_forming.SheetState: ("verify.sheet",),
    claims_forming.FormingFeed: ("verify.forming_feed",),
    claims_forming.ToolsLean: ("verify.lean",),
    claims_forming.SinksHolder: ("verify.holder",),
    claims_forming.FormsInOrder: ("verify.feature_order",),
    claims_forming.FormsByTable: ("verify.adsif",),
    claims_forming.FormsPart: ("verify.forming_part", "verify.forming_claims"),
    claims_milling.MillsSurface: ("verify.milled",),
    claims_milling.MillsAlong: ("verify.mill_path", "verify.mill_feed"),
    claims_milling.MillsProgram: ("verify.mill_path", "verify.mill_feed", "verify.spindle"),
    claims_milling.Engraves: ("verify.mill_path", "verify.mill_feed"),
    claims_milling.MillsFlank: ("verify.mill_path", "verify.mill_feed"),
    claims_milling.MillsOver: ("verify.mill_path", "verify.mill_feed"),
    claims_milling.SparesPart: ("verify.mill_gouge",),
}
"""The rules that prove each kind of claim."""


def unproven(claims: Mapping[str, tuple[Claim, ...]]) -> list[Issue]:
    """What is claimed of an operation though no rule proves it, and operations of which nothing is claimed;
    ``claims`` by the operation's name."""
    out = []
    for name, group in claims.items():
        inner = [c for claim in group if isinstance(claim, OneOf) for one in claim.either for c in one]
        known = (type(claim) for claim in (*group, *inner) if type(claim) not in PROVEN_BY)
        for kind in dict.fromkeys(known):
            what = f"{name}: its process claims {kind.__name__}, which no rule of the proof looks at"
            hint = "give the proof a rule for it, or claim what there are rules for"
            out.append(Issue("claims.unproven", f"{what}; {hint}", field="operations.process"))
        if not group:
            what = f"{name}: its process claims nothing, so nothing of it would be proven"
            what += "; let it claim what has to hold"
            out.append(Issue("claims.none", what, field="operations.process"))
    return out
