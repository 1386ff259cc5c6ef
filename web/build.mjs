// Bundles src/ into single files under src/motionkit/assets/web; see README.md.

import { createHash } from "node:crypto";
import { copyFileSync, existsSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "..", "src", "motionkit", "assets", "web");
const DEMO_HEAD = `<meta name="description" content="A person who walks, runs, dances and turns cartwheels as you ask, made by a small neural network in this page.">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; connect-src 'self' blob: data:; img-src data: blob:; worker-src 'self'; base-uri 'none'; form-action 'none'">
`;
const DEMO_BODY = `<noscript><div class="notice">This page needs JavaScript: it runs the model.</div></noscript>
<script type="application/json" id="data">__DATA__</script>
`;
// The folder of a page's HTML and style, and what only this page has in its head and body.
const PAGES = { play: ["play", "", ""], view: ["view", "", ""], demo: ["play", DEMO_HEAD, DEMO_BODY] };

/** The hash of everything a bundle is made of; tests/view/test_web_assets.py computes the same. */
function sourceHash() {
  const files = readdirSync(join(here, "src"), { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => relative(here, join(entry.parentPath, entry.name)).replaceAll("\\", "/"));
  const hash = createHash("sha256");
  for (const file of [...files, "build.mjs", "package-lock.json"].sort()) {
    hash.update(`${file}\n`).update(readFileSync(join(here, file))).update("\n");
  }
  return hash.digest("hex");
}

if (!existsSync(join(here, "node_modules"))) throw new Error("run `npm ci` first");
const licences = ["three", "@pixiv/three-vrm"].map((name) => `${readFileSync(join(here, "node_modules", name, "LICENSE"), "utf8").trim()}\n\n`).join("") +
  "The decoder of meshoptimizer, within three.js, is under the same terms.\nCopyright (C) 2016-2026, by Arseny Kapoulkine\n";

async function page(name) {
  const bundle = async (file, loader) => {
    const result = await build({
      entryPoints: [join(here, "src", name, file)],
      bundle: true,
      minify: true,
      write: false,
      format: "iife",
      target: ["es2022"],
      legalComments: "none",
      loader,
    });
    return result.outputFiles[0].text.trim();
  };
  const script = (await bundle("main.js")).replaceAll("</script", "<\\/script");
  const [folder, head, body] = PAGES[name];
  const source = (file) => readFileSync(join(here, "src", file), "utf8");
  const parts = { __SOURCE__: sourceHash(), __STYLE__: source("lib/theme.css") + source(`${folder}/style.css`), __SCRIPT__: script, __NAME__: name };
  const notice = `<!-- Contains three.js and three-vrm:\n\n${licences}-->\n`;
  const html = source(`${folder}/index.html`).replace("<head>\n", `<head>\n${notice}`).replace("__HEAD__", head).replace("__BODY__", body);
  return html.replace(/__(SOURCE|STYLE|SCRIPT|NAME)__/g, (mark) => parts[mark]);
}

mkdirSync(out, { recursive: true });
for (const name of Object.keys(PAGES)) {
  const file = join(out, `${name}.html`);
  const html = await page(name);
  if (process.argv.includes("--check")) {
    if (!existsSync(file) || readFileSync(file, "utf8") !== html) throw new Error(`${file} is out of date: run npm run build`);
  } else writeFileSync(file, html);
  console.log(`${name}.html ${(html.length / 1024).toFixed(0)} KiB`);
}
writeFileSync(join(out, "three-LICENSE.txt"), licences);
copyFileSync(join(here, "src/demo/sw.js"), join(out, "demo-sw.js"));
