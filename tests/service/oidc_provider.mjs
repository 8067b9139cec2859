// A real provider of accounts for tests (npm's oidc-provider): node oidc_provider.mjs PORT CALLBACK PACKAGE
// Whoever logs in is who he says; his name is his groups, too, joined by a +.
import { pathToFileURL } from "node:url";

const [port, callback, folder] = process.argv.slice(2);
const { default: Provider } = await import(pathToFileURL(`${folder}/lib/index.js`));
const provider = new Provider(`http://127.0.0.1:${port}`, {
  clients: [{ client_id: "tandem", client_secret: "s3cret-s3cret-s3cret", redirect_uris: [callback] }],
  claims: { openid: ["sub", "groups"], email: ["email", "email_verified"], profile: ["preferred_username"] },
  conformIdTokenClaims: false,
  pkce: { required: () => true },
  async findAccount(context, id) {
    const claims = { sub: id, groups: id.split("+"), email: `${id.split("+")[0]}@shop.example`, email_verified: true };
    return { accountId: id, claims: async () => claims };
  },
});
provider.listen(Number(port), "127.0.0.1", () => console.log("ready"));
