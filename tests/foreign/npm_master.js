// A CANopen master that is not ours: the npm package `canopen` walks a CiA 402 drive through everything a master asks.
// Frames come and go as lines of JSON, {"id": 1411, "data": "4b..."}; {"order": "fault"} asks for a fault of the drive;
// {"passed": "..."} after each part, {"failed": "..."} at the first that is not as CiA 301 and 402 have it.
const readline = require('readline');
const { Device, DataType } = require('canopen');

const drive = Number(process.argv[2]);
const PATIENCE_MS = 30000; // only a failing test waits this long
const say = (object) => process.stdout.write(JSON.stringify(object) + '\n');
const device = new Device({ id: 0x7e });
device.addListener('message', ({ id, data }) => say({ id, data: Buffer.from(data).toString('hex') }));
readline.createInterface({ input: process.stdin }).on('line', (line) => {
    const { id, data } = JSON.parse(line);
    const bytes = Buffer.from(data, 'hex');
    device.receive({ id, data: bytes, len: bytes.length });
});

const check = (holds, what) => { if (!holds) throw new Error(what); };
const read = (index, subIndex, dataType, more = {}) =>
    device.sdo.upload({ serverId: drive, index, subIndex, dataType, timeout: PATIENCE_MS, ...more });
const write = (index, subIndex, data, dataType, more = {}) =>
    device.sdo.download({ serverId: drive, index, subIndex, data, dataType, timeout: PATIENCE_MS, ...more });
const next = (emitter, event, accept = () => true) => new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error(`no ${event}`)), PATIENCE_MS);
    const listener = (...values) => {
        if (accept(...values)) {
            clearTimeout(timer);
            emitter.removeListener(event, listener);
            resolve(values);
        }
    };
    emitter.addListener(event, listener);
});
const STATES = { 0x40: 0x4f, 0x21: 0x6f, 0x23: 0x6f, 0x27: 0x6f, 0x07: 0x6f };
async function state(word, expected) {
    await write(0x6040, 0, word, DataType.UNSIGNED16);
    const status = await read(0x6041, 0, DataType.UNSIGNED16);
    check((status & STATES[expected]) === expected, `statusword ${status.toString(16)} after ${word.toString(16)}`);
}

const parts = {
    async transfers() {
        check(await read(0x1000, 0, DataType.UNSIGNED32) === 0x20192, 'device type, expedited');
        const name = await read(0x1008, 0, DataType.VISIBLE_STRING);
        check(name.length > 20, `name, segmented: ${name}`);
        const block = await read(0x1008, 0, DataType.VISIBLE_STRING, { blockTransfer: true });
        check(block === name, `name, by blocks: ${block}`);
        for (const length of [1, 7, 8, 100]) {
            for (const blockTransfer of [false, true]) {
                const text = 'abcdefghij'.repeat(10).slice(0, length - 1) + (blockTransfer ? 'X' : 'Y');
                await write(0x2000, 0, text, DataType.VISIBLE_STRING, { blockTransfer });
                check(await read(0x2000, 0, DataType.VISIBLE_STRING) === text, `${length} bytes, block ${blockTransfer}`);
            }
        }
        const refused = await write(0x1008, 0, 'x', DataType.VISIBLE_STRING).then(() => 0, (error) => error.code);
        check(refused === 0x06010002, `abort code ${refused}`);
    },
    async heartbeat() {
        await write(0x1017, 0, 100, DataType.UNSIGNED16); // ms: as often as software emulation keeps up with
        await next(device.nmt, 'heartbeat', (event) => (event.deviceId ?? event) === drive);
        device.nmt.startNode(drive);
        let seen = 0;
        while (seen !== 5)
            seen = await device.nmt.getNodeState(drive, PATIENCE_MS);
    },
    async pdo() {
        device.nmt.enterPreOperational(drive);
        const id = 0x180 + drive;
        const put = (index, subIndex, value, dataType) => write(index, subIndex, value, dataType);
        await put(0x1800, 1, 0xc0000000 + id, DataType.UNSIGNED32);
        await put(0x1800, 2, 1, DataType.UNSIGNED8);
        await put(0x1a00, 0, 0, DataType.UNSIGNED8);
        await put(0x1a00, 1, 0x60410010, DataType.UNSIGNED32);
        await put(0x1a00, 2, 0x60610008, DataType.UNSIGNED32);
        await put(0x1a00, 0, 2, DataType.UNSIGNED8);
        await put(0x1800, 1, 0x40000000 + id, DataType.UNSIGNED32);
        device.nmt.startNode(drive);
        const heard = next(device.pdo, 'pdo', ({ cobId }) => cobId === id);
        device.protocol.sync.write();
        const [{ dataObjects }] = await heard;
        check((dataObjects[0].value & 0x4f) === 0x40, `statusword by PDO ${dataObjects[0].value}`);
    },
    async states() {
        await write(0x6060, 0, 10, DataType.INTEGER8);
        check(await read(0x6061, 0, DataType.INTEGER8) === 10, 'mode display');
        await state(0x06, 0x21);
        await state(0x07, 0x23);
        await state(0x0f, 0x27);
        await state(0x02, 0x40); // quick stop, whose option leads to switch on disabled
        await state(0x06, 0x21);
        await state(0x0f, 0x27);
        await write(0x6071, 0, 250, DataType.INTEGER16);
        device.protocol.sync.write();
        check(await read(0x6077, 0, DataType.INTEGER16) === 250, 'torque');
    },
    async emergency() {
        const heard = next(device.emcy, 'emergency');
        say({ order: 'fault' });
        const [{ em }] = await heard;
        check(em.code === 0x6100, `emergency ${em.code}`);
        check(((await read(0x6041, 0, DataType.UNSIGNED16)) & 0x4f) === 0x08, 'fault');
        await write(0x6040, 0, 0x00, DataType.UNSIGNED16);
        await state(0x80, 0x40);
    },
};

async function main() {
    device.eds.addSdoClientParameter(drive, 0x600 + drive, 0x580 + drive);
    device.eds.addHeartbeatConsumer(drive, PATIENCE_MS);
    device.eds.addEmcyConsumer(0x80 + drive);
    device.eds.setSyncCobId(0x80);
    device.eds.setSyncGenerationEnable(true);
    const word = device.eds.addEntry(0x6041, { parameterName: 'Statusword', dataType: DataType.UNSIGNED16 });
    const mode = device.eds.addEntry(0x6061, { parameterName: 'Mode', dataType: DataType.INTEGER8 });
    device.eds.addReceivePdo({ cobId: 0x180 + drive, dataObjects: [word, mode] });
    device.start();
    device.nmt.startNode();
    for (const [name, part] of Object.entries(parts)) {
        await part();
        say({ passed: name });
    }
}

main().then(() => process.exit(0), (error) => {
    say({ failed: String(error.stack ?? error) });
    process.exit(1);
});
