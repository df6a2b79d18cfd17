/** Return a PNG of a canvas on an opaque ground; `drawOver` adds what lies over it, in CSS pixels. */
export function opaquePicture(
  canvas: HTMLCanvasElement,
  ground: string,
  drawOver: (pen: CanvasRenderingContext2D) => void,
): Promise<Blob> {
  const joined = document.createElement("canvas");
  joined.width = canvas.width;
  joined.height = canvas.height;
  const pen = joined.getContext("2d")!;
  pen.fillStyle = ground;
  pen.fillRect(0, 0, joined.width, joined.height);
  pen.drawImage(canvas, 0, 0);
  pen.setTransform(joined.width / canvas.clientWidth, 0, 0, joined.height / canvas.clientHeight, 0, 0);
  drawOver(pen);
  return new Promise((resolve, reject) =>
    joined.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("the browser made no picture"))), "image/png"),
  );
}
