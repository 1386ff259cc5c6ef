// Bundles src/ into single files under src/motionkit/assets/web; see README.md.

import { createHash } from "node:crypto";
import { copyFileSync, existsSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = join(here, "..", "src", "motionkit", "assets", "web");
const PAGES = { play: ["play"], view: ["view"], demo: ["play", "demo"] }; // and the folders of their styles

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
  const sheets = ["lib/theme.css", ...PAGES[name].map((folder) => `${folder}/style.css`)];
  const style = sheets.map((sheet) => readFileSync(join(here, "src", sheet), "utf8")).join("");
  const parts = { __SOURCE__: sourceHash(), __STYLE__: style, __SCRIPT__: script };
  const notice = "<!-- Contains three.js, MIT licence, copyright 2010-2026 three.js authors -->\n";
  const html = readFileSync(join(here, "src", name, "index.html"), "utf8").replace("<head>\n", `<head>\n${notice}`);
  return html.replace(/__(SOURCE|STYLE|SCRIPT)__/g, (mark) => parts[mark]);
}

if (!existsSync(join(here, "node_modules"))) throw new Error("run `npm ci` first");
mkdirSync(out, { recursive: true });
for (const name of Object.keys(PAGES)) {
  const file = join(out, `${name}.html`);
  const html = await page(name);
  if (process.argv.includes("--check")) {
    if (!existsSync(file) || readFileSync(file, "utf8") !== html) throw new Error(`${file} is out of date: run npm run build`);
  } else writeFileSync(file, html);
  console.log(`${name}.html ${(html.length / 1024).toFixed(0)} KiB`);
}
copyFileSync(join(here, "node_modules/three/LICENSE"), join(out, "three-LICENSE.txt"));
copyFileSync(join(here, "src/demo/sw.js"), join(out, "demo-sw.js"));
