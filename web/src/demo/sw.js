// Caches the files of this version, so that the page works offline after the first visit.

// Other pages of this origin may hold other models.
const OURS = `motionkit-${registration.scope}-`;
const NAME = `${OURS}__VERSION__`;
const FILES = ["./", "index.html", "model.bin", "motionkit.wasm"];

// Revalidates with the server, because the browser's cache may hold another version.
const anew = (file) => new Request(file, { cache: "no-cache" });

self.addEventListener("install", (event) => {
  event.waitUntil(caches.open(NAME).then((cache) => cache.addAll(FILES.map(anew))).then(() => self.skipWaiting()));
});

self.addEventListener("activate", (event) => {
  const others = (names) => names.filter((name) => name.startsWith(OURS) && name !== NAME);
  event.waitUntil(caches.keys().then((names) => Promise.all(others(names).map((name) => caches.delete(name)))));
});

self.addEventListener("fetch", (event) => {
  event.respondWith(caches.match(event.request, { cacheName: NAME, ignoreSearch: true }).then((kept) => kept ?? fetch(event.request)));
});
