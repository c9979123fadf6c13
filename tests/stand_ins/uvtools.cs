// The few calls of UVtools and Emgu.CV that plugin/uvtools/layerfix.cs makes, on a folder of portable grey maps: it is
// compiled and run with this in tests/test_resin_plugins.py. Images are written as PNG by an outside program, because
// there is no codec here: `png` turns `.pgm` into `.png` and back.
using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Threading;

namespace Emgu.CV.CvEnum
{
    public enum ImreadModes { Grayscale }
}

namespace Emgu.CV
{
    public class Mat : IDisposable
    {
        public int Width, Height;
        public byte[] Data = new byte[0];
        public void Dispose() { }

        public static Mat Load(string path)
        {
            var all = File.ReadAllBytes(path);
            var head = System.Text.Encoding.ASCII.GetString(all, 0, Math.Min(64, all.Length)).Split('\n');
            var size = head[1].Split(' ');
            var mat = new Mat { Width = int.Parse(size[0]), Height = int.Parse(size[1]) };
            mat.Data = new byte[mat.Width * mat.Height];
            Array.Copy(all, all.Length - mat.Data.Length, mat.Data, 0, mat.Data.Length);
            return mat;
        }

        public void Store(string path)
        {
            using (var file = File.Create(path))
            {
                var head = System.Text.Encoding.ASCII.GetBytes("P5\n" + Width + " " + Height + "\n255\n");
                file.Write(head, 0, head.Length);
                file.Write(Data, 0, Data.Length);
            }
        }
    }

    public static class CvInvoke
    {
        static void Convert(string from, string to)
        {
            var command = Environment.GetEnvironmentVariable("PNG").Split('|');
            var process = Process.Start(command[0], command[1] + " \"" + from + "\" \"" + to + "\"");
            process.WaitForExit();
            if (process.ExitCode != 0) throw new IOException(from);
        }

        public static bool Imwrite(string path, Mat mat)
        {
            mat.Store(path + ".pgm");
            Convert(path + ".pgm", path);
            File.Delete(path + ".pgm");
            return true;
        }

        public static Mat Imread(string path, CvEnum.ImreadModes mode)
        {
            Convert(path, path + ".pgm");
            var mat = Mat.Load(path + ".pgm");
            File.Delete(path + ".pgm");
            return mat;
        }

        public static void AbsDiff(Mat a, Mat b, Mat difference)
        {
            if (a.Data.Length != b.Data.Length) throw new ArgumentException("sizes differ");
            difference.Data = new byte[a.Data.Length];
            for (var i = 0; i < a.Data.Length; i++) difference.Data[i] = (byte)Math.Abs(a.Data[i] - b.Data[i]);
        }

        public static int CountNonZero(Mat mat)
        {
            var count = 0;
            foreach (var value in mat.Data) if (value != 0) count++;
            return count;
        }
    }
}

namespace UVtools.Core.Scripting
{
    public class ScriptNumericalInput<T>
    {
        public string Label, ToolTip, Unit;
        public T Minimum, Maximum, Increment, Value;
    }

    public class Layer
    {
        public string Path;
        public static readonly List<string> Set = new List<string>();
        public Emgu.CV.Mat LayerMat
        {
            get { return Emgu.CV.Mat.Load(Path); }
            set { value.Store(Path); Set.Add(System.IO.Path.GetFileName(Path)); }
        }
    }

    public class File3D
    {
        public float PixelWidth, PixelHeight, LayerHeight;
        public List<Layer> Layers = new List<Layer>();
        public Layer this[uint index] { get { return Layers[(int)index]; } }
    }

    public class Configuration
    {
        public string Name, Description, Author;
        public Version Version;
        public List<object> UserInputs = new List<object>();
    }

    public class Range { public uint LayerIndexStart, LayerIndexEnd; }

    public class Bar
    {
        public readonly CancellationTokenSource Source = new CancellationTokenSource();
        public CancellationToken Token { get { return Source.Token; } }
        public void Reset(string name, uint count) { }
        public void LockAndIncrement() { }
    }

    public class ScriptGlobals
    {
        public Configuration Script = new Configuration();
        public File3D SlicerFile = new File3D();
        public Range Operation = new Range();
        public Bar Progress = new Bar();
    }
}

public static class Program
{
    // FOLDER of .pgm layers, pixel width and height in mm, layer height in mm, minimum feature in µm
    public static int Main(string[] given)
    {
        var script = new UVtools.ScriptSample.ScriptLayerfix();
        var culture = System.Globalization.CultureInfo.InvariantCulture;
        script.SlicerFile.PixelWidth = float.Parse(given[1], culture);
        script.SlicerFile.PixelHeight = float.Parse(given[2], culture);
        script.SlicerFile.LayerHeight = float.Parse(given[3], culture);
        var paths = Directory.GetFiles(given[0], "*.pgm");
        Array.Sort(paths, StringComparer.Ordinal);
        foreach (var path in paths)
            script.SlicerFile.Layers.Add(new UVtools.Core.Scripting.Layer { Path = path });
        script.Operation.LayerIndexEnd = (uint)(paths.Length - 1);
        script.ScriptInit();
        foreach (var input in script.Script.UserInputs)
            ((UVtools.Core.Scripting.ScriptNumericalInput<ushort>)input).Value = ushort.Parse(given[4], culture);
        var wrong = script.ScriptValidate();
        if (!string.IsNullOrEmpty(wrong)) { Console.WriteLine("invalid: " + wrong); return 3; }
        try
        {
            var done = script.ScriptExecute();
            Console.WriteLine("set: " + string.Join(" ", UVtools.Core.Scripting.Layer.Set));
            return done ? 0 : 1;
        }
        catch (InvalidOperationException problem)
        {
            Console.WriteLine("failed: " + problem.Message);
            return 4;
        }
    }
}
