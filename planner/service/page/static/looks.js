// Links to look at a job: which there are, a new one, and taking one back.
import { job as path, json, post, remove } from "./api.js";
import { $, announce, h, show } from "./dom.js";
import { minute } from "./words.js";

export function setUpLooks(id) {
  const trying = (action) => async () => {
    show($("looks-fault"), false);
    try {
      await action();
    } catch (error) {
      $("looks-fault").textContent = error.message;
      show($("looks-fault"), true);
    }
  };
  const draw = async () => {
    const { links } = await json(`${path(id)}/looks`);
    show($("looks-none"), links.length === 0);
    $("looks-list").replaceChildren(
      ...links.map((one) => h("li", {}, h("span", {}, "created by ", h("bdi", {}, one.by), ` ${minute(one.created)}, expires ${minute(one.expires)}`), h("button", { type: "button", class: "small danger", "aria-label": `Withdraw the link that expires ${minute(one.expires)}`, onclick: trying(() => withdraw(one)) }, "Withdraw"))),
    );
  };
  const withdraw = async (one) => {
    await remove(`${path(id)}/looks/${one.id}`);
    show($("looks-new"), false);
    announce("The link is withdrawn");
    await draw();
    $("looks-make").focus();
  };
  const make = async () => {
    if (!$("looks-days").reportValidity()) return;
    const seconds = Math.round(Number($("looks-days").value) * 86400);
    const made = await (await post(`${path(id)}/looks?seconds=${seconds}`)).json();
    $("looks-address").value = new URL(made.path, location.origin).href;
    show($("looks-new"), true);
    await draw();
    $("looks-address").focus();
    $("looks-address").select();
    announce("A link was created");
  };
  $("looks").addEventListener("click", () => {
    show($("looks-new"), false);
    $("looks-address").value = "";
    $("looks-ask").showModal();
    trying(draw)();
  });
  $("looks-make").addEventListener("click", trying(make));
}
