"""The API's routes about webhooks: made, listed, tried, deleted."""

from typing import Annotated, Any, Final

import anyio.to_thread
from fastapi import APIRouter, Path, Request, Response

from planner.service.models import NewWebhook, WebhookList, WebhookMade, WebhookOut, utc
from planner.service.routes import ASKED, Caller, Here, refusals
from planner.service.texts import described, read_body

router: Final = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], responses=ASKED)
Number = Annotated[str, Path(max_length=64, description="a webhook's `id`")]


@router.post(
    "",
    status_code=201,
    response_model_exclude_none=True,
    responses=refusals(413, 422, 429),
    openapi_extra=described(NewWebhook),
    summary="Have an address told of jobs that end",
)
async def add(request: Request, owner: Caller, here: Here) -> WebhookMade:
    """The address gets a POST for each of your jobs that ends, as Standard Webhooks 1.0 has it, signed with
    the `secret` of this answer, which is told this once."""
    asked = await read_body(request, NewWebhook)
    row = await anyio.to_thread.run_sync(here.webhooks.add, owner, asked.url)
    return WebhookMade(**_told(row), secret=row["secret"])


@router.get("", response_model_exclude_none=True, summary="Webhooks")
def known(owner: Caller, here: Here) -> WebhookList:
    """Yours, the oldest first, with how the last attempt went."""
    rows = here.webhooks.list(owner)
    return WebhookList(webhooks=[WebhookOut(**_told(row), waiting=row["waiting"]) for row in rows])


@router.post("/{webhook}/ping", status_code=202, responses=refusals(404), summary="Try a webhook")
def ping(webhook: Number, owner: Caller, here: Here) -> Response:
    """Its address gets a `ping`, soon; one that was off is on again."""
    here.webhooks.ping(owner, webhook)
    return Response(status_code=202)


@router.delete("/{webhook}", status_code=204, responses=refusals(404), summary="Delete a webhook")
def remove(webhook: Number, owner: Caller, here: Here) -> Response:
    """Its address is told nothing more."""
    here.webhooks.remove(owner, webhook)
    return Response(status_code=204)


def _told(row: Any) -> dict[str, Any]:
    known = {name: row[name] for name in ("id", "url", "outcome")}
    times = {name: row[name] for name in ("created", "told", "off")}
    return known | {name: at if at is None else utc(at) for name, at in times.items()}
