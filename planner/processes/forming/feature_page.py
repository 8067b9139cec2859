"""Page with a drawing of the features of a sheet part."""

import html

from planner.geometry.units import MM
from planner.processes.forming.plan.features.tree import FeatureTree, plan_drawing, tree_diagram


def drawing_page(tree: FeatureTree, title: str) -> str:
    """Return one self-contained HTML page with the contours from above, the feature tree and a table.

    Args:
        tree: Features of the part.
        title: Title of the page.
    """
    from planner.report.markup import CSS

    rows = "".join(
        f"<tr><td>{f.id}</td><td>{f.parent or '–'}</td><td>{f.kind}</td><td>{f.start / MM:z.3f}</td>"
        f"<td>{f.end / MM:z.3f}</td><td>{len(f.contours)}</td></tr>"
        for f in tree.features
    )
    name = html.escape(title)
    notes = "".join(f'<p class="note">{html.escape(str(issue))}</p>' for issue in tree.issues)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{name}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{CSS}</style><main><h1>{name}</h1>'
        f'<p class="soft">{len(tree.features)} features, sliced every {tree.step / MM:g} mm; '
        f"the flat sheet is at z = {tree.level / MM:z.3f} mm. "
        f"Solid: down (concave), dashed: up (convex).</p>{notes}"
        f"<section><h2>Contours from above</h2>{plan_drawing(tree)}</section>"
        f"<section><h2>Tree over the level</h2>{tree_diagram(tree)}</section><section><h2>Features</h2>"
        "<table><tr><th>id</th><th>on</th><th>kind</th><th>start mm</th><th>end mm</th><th>contours</th></tr>"
        f"{rows}</table></section></main></html>\n"
    )
