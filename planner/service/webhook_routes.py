"""API routes of webhooks: create, list, test, delete."""

from typing import Annotated, Any, Final

import anyio.to_thread
from fastapi import APIRouter, Path, Request, Response

from planner.service.models import NewWebhook, WebhookList, WebhookMade, WebhookOut, utc
from planner.service.routes import AUTH_REFUSALS, AuthorisedOwner, CurrentService, refusals
from planner.service.user_texts import body_description, read_body

router: Final = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], responses=AUTH_REFUSALS)
Number = Annotated[str, Path(max_length=64, description="`id` of a webhook")]


@router.post(
    "",
    status_code=201,
    response_model_exclude_none=True,
    responses=refusals(413, 422, 429),
    openapi_extra=body_description(NewWebhook),
    summary="Create a webhook for jobs that end",
)
async def add(request: Request, owner: AuthorisedOwner, service: CurrentService) -> WebhookMade:
    """The address receives a POST for each of your jobs that ends, as in Standard Webhooks 1.0.

    It is signed with the `secret` of this answer, which is shown only once.
    """
    body = await read_body(request, NewWebhook)
    row = await anyio.to_thread.run_sync(service.webhooks.add, owner, body.url)
    return WebhookMade(**_webhook_fields(row), secret=row["secret"])


@router.get("", response_model_exclude_none=True, summary="Webhooks")
def known(owner: AuthorisedOwner, service: CurrentService) -> WebhookList:
    """Webhooks of the caller, oldest first, with the result of the last attempt."""
    rows = service.webhooks.list(owner)
    return WebhookList(webhooks=[WebhookOut(**_webhook_fields(row), waiting=row["waiting"]) for row in rows])


@router.post("/{webhook}/ping", status_code=202, responses=refusals(404), summary="Test a webhook")
def ping(webhook: Number, owner: AuthorisedOwner, service: CurrentService) -> Response:
    """The address receives a `ping` shortly. A disabled webhook is enabled again."""
    service.webhooks.ping(owner, webhook)
    return Response(status_code=202)


@router.delete("/{webhook}", status_code=204, responses=refusals(404), summary="Delete a webhook")
def remove(webhook: Number, owner: AuthorisedOwner, service: CurrentService) -> Response:
    """The address receives no more notifications."""
    service.webhooks.remove(owner, webhook)
    return Response(status_code=204)


def _webhook_fields(row: Any) -> dict[str, Any]:
    fields = {name: row[name] for name in ("id", "url", "outcome")}
    times = {name: row[name] for name in ("created", "told", "off")}
    return fields | {name: at if at is None else utc(at) for name, at in times.items()}
