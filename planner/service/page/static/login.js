// Exchanges a token for a session cookie.
import { post, Refused } from "./api.js";
import { $ } from "./dom.js";
import { atFields } from "./issues.js";

const next = new URLSearchParams(location.search).get("next") ?? "/";
const inside = /^\/(?![/\\])/.test(next) ? next : "/";

const account = document.getElementById("account");
if (account) account.href = `/ui/oidc/login?after=${encodeURIComponent(inside)}`;

$("login").addEventListener("submit", async (event) => {
  event.preventDefault();
  const token = $("token").value.trim();
  try {
    if (!/^[\x21-\x7e]+$/.test(token)) throw new Refused(401, [{ code: "service.token", field: "Authorization", message: "invalid token. Enter the token as it was printed." }]);
    await post("/v1/session", { headers: { Authorization: `Bearer ${token}` } });
    location.assign(inside);
  } catch (error) {
    const issues = error.issues ?? [{ code: "service.request", message: error.message }];
    atFields(issues.map((issue) => ({ ...issue, field: "Authorization" })));
    $("token").focus();
  }
});
// Not before: what is sent without this script goes nowhere.
$("send").disabled = false;
$("token").focus();
