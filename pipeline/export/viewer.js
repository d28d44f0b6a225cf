// One WebGL context shows one mesh at a time, because phones allow few. Angles are the project's: at azimuth 0 the camera
// sees the front (+z), at 90 degrees the side at +x.
(() => {
  const viewer = document.querySelector('.viewer');
  const find = selector => viewer.querySelector(selector);
  const canvas = find('canvas'), stage = find('.stage'), spinButton = find('[name=spin]');
  const sliders = { azimuth: find('[name=azimuth]'), elevation: find('[name=elevation]') };
  const choices = [...viewer.querySelectorAll('[name=exhibit]')];
  const surfaces = [...viewer.querySelectorAll('[name=surface]')];
  const radians = THREE.MathUtils.degToRad, DRAG = 0.5, KEY_STEP = 5, SPIN = 24; // degrees a pixel, a key, a second
  const KEYS = { ArrowLeft: [-KEY_STEP, 0], ArrowRight: [KEY_STEP, 0], ArrowUp: [0, KEY_STEP], ArrowDown: [0, -KEY_STEP] };
  const view = { azimuth: 0, elevation: 0 };
  let renderer = null, mesh = null, chosen = choices[0], surface = 'texture';
  let started = false, onScreen = false, frame = 0, before = 0;
  let spinning = !matchMedia('(prefers-reduced-motion: reduce)').matches;

  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(Number(viewer.dataset.fieldOfView), 1);
  const lamp = new THREE.DirectionalLight(0xffffff, 0.75);
  lamp.position.set(-0.6, 0.9, 0.4); // upper left of the camera, which carries it
  camera.add(lamp);
  scene.add(camera, new THREE.HemisphereLight(0xffffff, 0x8d8d8d, 0.55));
  const clay = new THREE.MeshLambertMaterial({ color: new THREE.Color(0xd8d2c8).convertSRGBToLinear() });
  const facets = new THREE.MeshPhongMaterial({ color: clay.color, specular: 0, flatShading: true,
    polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
  const wire = new THREE.LineBasicMaterial({ color: new THREE.Color(0x3b4a54).convertSRGBToLinear() });

  function start() {
    started = true;
    try {
      renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    } catch {
      complain('This browser shows no 3D: it offers no WebGL.');
      return;
    }
    renderer.outputEncoding = THREE.sRGBEncoding;
    new ResizeObserver(resize).observe(stage);
    resize();
    choose(chosen);
    spin(spinning); // a choice that was made before has stopped it
  }

  function complain(text) { // in the place of the mesh; an empty text shows the mesh again
    find('.problem').textContent = text;
    find('.problem').hidden = !text;
    canvas.hidden = Boolean(text);
  }

  function resize() {
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    camera.aspect = canvas.clientWidth / canvas.clientHeight;
    camera.updateProjectionMatrix();
    draw();
  }

  function choose(choice) {
    chosen = choice;
    choice.checked = true;
    find('.shown').textContent = choice.dataset.name;
    canvas.setAttribute('aria-label', `${choice.dataset.name} in 3D, arrow keys turn it`);
    for (const pictures of viewer.querySelectorAll('.beside')) pictures.hidden = pictures.dataset.key !== choice.value;
    home();
    if (renderer) load(choice);
  }

  async function load(choice) {
    canvas.setAttribute('aria-busy', true);
    let loaded;
    try {
      const content = Uint8Array.from(atob(choice.dataset.glb), letter => letter.charCodeAt(0));
      loaded = await new THREE.GLTFLoader().parseAsync(content.buffer, '');
    } catch (error) {
      complain(`The mesh of ${choice.dataset.name} cannot be read; write the page anew.`);
      throw error;
    }
    if (choice !== chosen) return;
    complain('');
    if (mesh) discard();
    mesh = loaded.scene.getObjectByProperty('isMesh', true);
    mesh.userData.painted = mesh.material;
    mesh.add(new THREE.LineSegments(new THREE.WireframeGeometry(mesh.geometry), wire));
    scene.add(mesh);
    dress();
    canvas.setAttribute('aria-busy', false);
  }

  function discard() {
    scene.remove(mesh);
    mesh.userData.painted.map.dispose();
    for (const part of [mesh.userData.painted, mesh.geometry, mesh.children[0].geometry]) part.dispose();
  }

  function dress() {
    const worn = surface === 'texture' && !chosen.dataset.textured ? 'clay' : surface;
    for (const option of surfaces) {
      option.checked = option.value === worn;
      option.disabled = option.value === 'texture' && !chosen.dataset.textured;
    }
    if (!mesh) return;
    mesh.material = { texture: mesh.userData.painted, clay, polygons: facets }[worn];
    mesh.children[0].visible = worn === 'polygons';
    draw();
  }

  function look(azimuth, elevation, moved = null) { // a slider that is being moved stays where it is
    view.azimuth = 180 - THREE.MathUtils.euclideanModulo(180 - azimuth, 360); // above -180, up to 180
    view.elevation = THREE.MathUtils.clamp(elevation, Number(sliders.elevation.min), Number(sliders.elevation.max));
    for (const [name, slider] of Object.entries(sliders)) {
      if (slider !== moved) slider.value = view[name];
      slider.setAttribute('aria-valuetext', `${slider.value} degrees`);
      slider.parentElement.nextElementSibling.textContent = `${slider.value}°`;
    }
    draw();
  }

  function home() { look(Number(chosen.dataset.azimuth), Number(chosen.dataset.elevation)); }

  function draw() {
    if (!frame) frame = requestAnimationFrame(render);
  }

  function render(now) {
    frame = 0;
    if (!mesh) return;
    if (spinning && onScreen) look(view.azimuth + SPIN * Math.min(now - before, 100) / 1000, view.elevation);
    before = now;
    const azimuth = radians(view.azimuth), elevation = radians(view.elevation), level = Math.cos(elevation);
    camera.position.set(Math.sin(azimuth) * level, Math.sin(elevation), Math.cos(azimuth) * level);
    camera.position.multiplyScalar(mesh.geometry.boundingSphere.radius / Math.sin(radians(camera.fov / 2)));
    camera.lookAt(0, 0, 0);
    camera.far = camera.position.length() + 2 * mesh.geometry.boundingSphere.radius;
    camera.near = camera.far / 100;
    camera.updateProjectionMatrix();
    renderer.render(scene, camera);
  }

  function spin(on) {
    spinning = on;
    spinButton.setAttribute('aria-pressed', on);
    draw();
  }

  function turn(byAzimuth, byElevation) {
    spin(false);
    look(view.azimuth + byAzimuth, view.elevation + byElevation);
  }

  for (const choice of choices) choice.addEventListener('change', () => { spin(false); choose(choice); });
  for (const option of surfaces) option.addEventListener('change', () => { surface = option.value; dress(); });
  for (const slider of Object.values(sliders)) slider.addEventListener('input', () => {
    spin(false);
    look(Number(sliders.azimuth.value), Number(sliders.elevation.value), slider);
  });
  spinButton.addEventListener('click', () => spin(!spinning));
  find('[name=home]').addEventListener('click', () => { spin(false); home(); });
  document.addEventListener('click', event => {
    const link = event.target.closest('[data-exhibit]');
    if (!link) return;
    event.preventDefault(); // following the link would take the focus away again
    spin(false);
    choose(choices.find(choice => choice.value === link.dataset.exhibit));
    viewer.scrollIntoView();
    canvas.focus({ preventScroll: true });
  });
  canvas.addEventListener('webglcontextrestored', draw);
  canvas.addEventListener('keydown', event => {
    if (event.altKey || event.ctrlKey || event.metaKey) return; // the browser's own, such as going back
    if (event.key === 'Home') { spin(false); home(); } else if (KEYS[event.key]) turn(...KEYS[event.key]); else return;
    event.preventDefault();
  });
  // Vertical strokes of a finger scroll the page (touch-action), so touch turns the azimuth alone.
  let held = null;
  canvas.addEventListener('pointerdown', event => {
    if (event.button) return;
    held = event;
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener('pointermove', event => {
    if (!held || event.pointerId !== held.pointerId) return;
    const up = event.pointerType === 'touch' ? 0 : event.clientY - held.clientY;
    turn((held.clientX - event.clientX) * DRAG, up * DRAG);
    held = event;
  });
  for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, () => { held = null; });
  new IntersectionObserver(entries => {
    onScreen = entries.at(-1).isIntersecting;
    if (onScreen && !started) start();
    draw();
  }, { rootMargin: '200px' }).observe(viewer);
  choose(chosen);
  dress();
})();
