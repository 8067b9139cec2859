"""Issue codes of the service, uploads and batches."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    "upload.unproven": IssueCode(
        "the result is not verified, or its files differ from those of its proof", is_input_error=True
    ),
    "upload.release": IssueCode(
        "the release of the result is withdrawn, is for other programs, or is required but missing",
        is_input_error=True,
    ),
    "upload.address": IssueCode(
        "the address of a controller, or what to send to it, is not stated", is_input_error=True
    ),
    "upload.controller": IssueCode("the controller is unreachable, or gives an unexpected answer"),
    "upload.login": IssueCode("the controller rejects the login, or its certificate is not trusted"),
    "upload.busy": IssueCode("the controller is running, in manual mode, or controlled by another client"),
    "upload.write": IssueCode("a file on the controller differs from the file that was sent"),
    "upload.differs": IssueCode("the controller differs from the one that the programs were planned for"),
    "upload.not_looked_at": IssueCode("a property of the controller was not read and therefore not compared"),
    "upload.missing": IssueCode("the expected programs are not on the controller"),
    "upload.touched": IssueCode("a target or data value on the controller differs from the result"),
    # many problems at once
    "batch.crashed": IssueCode("the process that planned a problem ended unexpectedly"),
    "batch.timeout": IssueCode("planning a problem exceeded the time limit"),
    "batch.memory": IssueCode("planning a problem exceeded the memory limit"),
    "batch.cancelled": IssueCode(
        "planning a problem was cancelled", message="{job}: planning was cancelled; start it again if needed"
    ),
    "batch.worker": IssueCode(
        "worker processes do not start",
        message="{failed_start_count} worker processes in a row did not start: the last one {exit_reason}",
    ),
    "batch.field": IssueCode(
        "a field of the batch file is missing, unknown or out of range", is_input_error=True
    ),
    "batch.csv": IssueCode(
        "the table of the batch file is unreadable, or a row does not match its header", is_input_error=True
    ),
    "batch.install": IssueCode("a cluster requires packages that are not installed", is_input_error=True),
    "batch.cluster": IssueCode("the cluster is unreachable, has no workers, or stopped responding"),
    "batch.versions": IssueCode(
        "a cluster worker has other package versions than the client",
        message="worker {worker} has {differences}; results would differ",
    ),
    "batch.in_use": IssueCode(
        "another batch is writing to the output folder",
        is_input_error=True,
        message="output folder {folder}: another batch is writing to it; wait for it, or choose another",
    ),
    # the service
    "service.install": IssueCode("the service requires packages that are not installed"),
    "service.database": IssueCode("the database of the service cannot be opened or is unreachable"),
    "service.not_planning": IssueCode(
        "the service accepts jobs, but none is planned at present",
        message="jobs are accepted but not planned at present",
    ),
    "service.start": IssueCode("the service cannot start with these options"),
    "service.request": IssueCode("a field of the request is missing, unknown or out of range"),
    "service.not_found": IssueCode("the service has no such resource, or does not support the method"),
    "service.token": IssueCode("missing, unknown, revoked or expired token"),
    "service.log_in": IssueCode("login with the account provider failed"),
    "service.damaged": IssueCode("a stored program is damaged and is not served"),
    "service.role": IssueCode("the role of the token does not permit the request"),
    "service.foreign": IssueCode("the request comes from another site"),
    "service.link": IssueCode(
        "the link is expired, withdrawn or not signed by the service, or the job has too many links"
    ),
    "service.unknown_job": IssueCode("unknown job"),
    "service.unknown_file": IssueCode("the job has no such file"),
    "service.not_uploaded": IssueCode(
        "the problem names a file that was not uploaded",
        message="{field}: {matches} named {file_name!r} (got {stated_path!r}, uploaded {uploaded_files})",
    ),
    "service.file_name": IssueCode("the name of an uploaded file is missing, too long or not unique"),
    "service.archive": IssueCode(
        "archives and compressed files are not accepted",
        message="{file!r}: is an archive or compressed. Unpack it and upload its files.",
    ),
    "service.too_large": IssueCode("an upload or one of its files exceeds the size limit"),
    "service.too_many": IssueCode(
        "the token has reached its limit of jobs, event streams or pending uploads"
    ),
    "service.stopping": IssueCode(
        "the service stopped while it read an upload", message="the service is stopping. Try again later."
    ),
    "service.storage": IssueCode("the storage quota of the token or of the service is exhausted"),
    "service.check_stopped": IssueCode(
        "checking the problem exceeded the limit of time or memory",
        message="the problem {exceeded_limit}. Use smaller meshes, tables and step counts.",
    ),
    "service.backup": IssueCode("a store of the service cannot be backed up or restored"),
    "service.idempotency": IssueCode("the idempotency key is invalid, or was used with another request"),
    "service.webhook": IssueCode(
        "the webhook address is not usable, or the webhook does not exist", message="webhook: {reason}"
    ),
    "service.state": IssueCode("the state of the job does not permit the request"),
    "service.release": IssueCode("the programs cannot be released, or the release cannot be withdrawn"),
    "service.draft": IssueCode("the draft does not exist, or was changed by another user"),
    "service.gave_up": IssueCode(
        "the service stopped several times while it worked on the job",
        message="the service failed {attempt_count} times while it planned this job. It does not try again.",
    ),
    "service.answer": IssueCode(
        "the server at this address does not answer like this service",
        message="job {job} is {state}; there is no plan",
    ),
    "service.timeout": IssueCode("the service did not answer, or the job did not end, within the time limit"),
    "service.version": IssueCode("the service is too new for the client, or too old for the request"),
}
